"""What the stages hand to each other."""

import torch

from offpiste.state import RecordedTerrain, Terrain, TerrainSource


def test_recorded_terrain_is_read_by_step_and_never_by_place():
    terrain = Terrain(torch.rand(2, 5, 4, 3), torch.rand(2, 5, 4) > 0.5, torch.rand(2, 5, 4, 6))
    source = RecordedTerrain(terrain)
    assert isinstance(source, TerrainSource)
    for t in range(5):
        here, there = (source.at(t, place * torch.ones(2, 6)) for place in (0.0, 100.0))
        assert torch.equal(here.normal, terrain.normal[:, t])
        assert torch.equal(here.known, terrain.known[:, t])
        assert torch.equal(here.latent, terrain.latent[:, t])
        assert torch.equal(here.normal, there.normal)
