"""Data passed between stages."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from offpiste.core.state import RecordedTerrain, Terrain, wrap_angle


@given(st.floats(-3.1, 3.1), st.integers(-5, 5))
def test_wrapping_removes_whole_turns(angle, turns):
    wrapped = wrap_angle(torch.tensor(angle + 2 * math.pi * turns, dtype=torch.float64))
    assert wrapped.item() == pytest.approx(angle, abs=1e-9)


def test_recorded_terrain_is_read_by_step_and_never_by_place():
    drawn = torch.rand(2, 5, 4, 10, generator=torch.Generator().manual_seed(0))
    terrain = Terrain(drawn[..., :3], drawn[..., 3] > 0.5, drawn[..., 4:])
    source = RecordedTerrain(terrain)
    for t, place in ((0, 0.0), (3, 0.0), (3, 100.0)):
        found = source.at(t, place * torch.ones(2, 6))
        assert torch.equal(found.normal, terrain.normal[:, t])
        assert torch.equal(found.known, terrain.known[:, t])
        assert torch.equal(found.latent, terrain.latent[:, t])
