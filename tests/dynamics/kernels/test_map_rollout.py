"""Rollouts over maps by kernels against the eager model in float64, which reads the same maps with `sample_maps`."""

import copy
from dataclasses import replace

import pytest
import torch

from factories import VEHICLE
from offpiste.core.state import ModelState, Trajectory
from offpiste.dynamics import Hybrid, Parametric, Vehicle, rollout
from offpiste.dynamics.feature_encoder import Compressor, Identity
from offpiste.dynamics.kernels import map_rollout
from offpiste.dynamics.kernels.encoder import supports_encoder
from offpiste.dynamics.kernels.map_rollout import predict_on, rollout_on_maps
from offpiste.mapping.terrain_sampler import CellStack, MapTerrain, last_cells

FEATURES, MAPS, SIDE = 5, 3, (60, 45)
TOLERANCE = 2e-5
"""Absolute and relative."""

CELLS = MAPS * SIDE[0] * SIDE[1]


def stack() -> CellStack:
    """Maps of several sizes, padded by cells that look known.

    Holes are of all kinds: no cell, no slope, features of which one is missing. Some numbers are tiny or negative.
    """
    draw = torch.Generator().manual_seed(0)
    place = torch.arange(CELLS, dtype=torch.int32).reshape(MAPS, *SIDE)
    place[torch.rand(place.shape, generator=draw) < 0.1] = -1
    slope = 0.2 * torch.randn(CELLS + 1, 2, generator=draw)
    features = torch.randn(CELLS + 1, FEATURES, generator=draw)
    features[::9] *= 1e-6  # subnormal in float16
    slope[torch.rand(CELLS + 1, generator=draw) < 0.05, 1] = torch.nan
    features[torch.rand(CELLS + 1, generator=draw) < 0.2, FEATURES - 1] = torch.nan
    slope[-1], features[-1] = torch.nan, torch.nan
    last = last_cells([SIDE, (SIDE[0] - 20, SIDE[1]), (SIDE[0] - 5, SIDE[1] - 13)])
    origin = torch.rand(MAPS, 2, generator=draw).double()
    return CellStack(0.5, origin, last, place, slope.half(), features.half())


def model_of(kind: str, vehicle: Vehicle) -> Hybrid | Parametric:
    """One with random weights, that reads all features but one."""
    torch.manual_seed(1)
    encoder = {"compressed": Compressor(FEATURES - 1, size=3), "direct": Identity(FEATURES - 1)}.get(kind)
    model = Parametric(vehicle) if kind == "parametric" else Hybrid(vehicle, encoder=encoder)
    for parameter in model.parameters():
        parameter.data += 0.3 * torch.randn_like(parameter)
    if encoder is not None:
        encoder.mean += 0.5
    return model


def run(model: Hybrid | Parametric, batch: int, *, eager: bool) -> Trajectory:
    """Vehicles anywhere on their maps, over the edges, and far off; one is nowhere."""
    dtype, draw = next(model.parameters()).dtype, torch.Generator().manual_seed(batch)
    state = torch.randn(batch, 6, generator=draw) * torch.tensor([9.0, 9.0, 3.0, 4.0, 0.5, 0.5])
    state[:, 3] += 3
    state[::11, :2] = torch.nan
    state[1::13, 0] += 1e4
    actuators = torch.rand(batch, 4, generator=draw) * torch.tensor([1.0, 0.6, 0.5, 3.0])
    controls = torch.rand(batch, 8, 3, generator=draw) - torch.tensor([0.0, 0.0, 0.5])
    recurrent = 0.5 * torch.randn(batch, model.recurrent_size, generator=draw)
    start = ModelState(*(each.to(dtype) for each in (state, actuators, recurrent)))
    number = torch.randint(MAPS, (batch,), generator=draw)
    offset = torch.rand(batch, 2, generator=draw).double() + torch.tensor([11.0, 15.0]).double()
    wheels = torch.tensor([[1.2, 0.7], [1.2, -0.7], [-0.9, 0.7], [-0.9, -0.7]])
    source = MapTerrain(stack(), number, offset, wheels, model.encoder)
    return (rollout if eager else predict_on)(model, start, controls.to(dtype), source)


@pytest.mark.parametrize(("kind", "batch"), [("compressed", 1), ("compressed", 33), ("direct", 33), ("parametric", 33)])
@torch.no_grad()
def test_kernels_agree_with_the_eager_model(kind: str, batch: int, monkeypatch: pytest.MonkeyPatch) -> None:
    model, called = model_of(kind, VEHICLE), []
    monkeypatch.setattr(map_rollout, "rollout_on_maps", lambda *given: called.append(1) or rollout_on_maps(*given))
    found = run(model, batch, eager=False)
    wanted = run(copy.deepcopy(model).double(), batch, eager=True)
    assert called
    for one, other in ((found.state, wanted.state), (found.actuators, wanted.actuators)):
        torch.testing.assert_close(one.double(), other, rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True)


def test_gradients_and_single_precision_are_left_to_the_eager_model_and_too_few_features_refused() -> None:
    model, maps = model_of("compressed", VEHICLE), stack()
    assert run(model, 3, eager=False).state.requires_grad
    state = ModelState(torch.zeros(1, 6), torch.zeros(1, 4), torch.zeros(1, model.recurrent_size))
    given = torch.zeros(1, dtype=torch.long), torch.full((1, 2), 9.0).double(), torch.zeros(4, 2)
    wide = replace(maps, features=maps.features.float())
    with torch.no_grad():
        first, second = (
            predict_on(model, state, torch.zeros(1, 5, 3), MapTerrain(each, *given, model.encoder)).state
            for each in (maps, wide)
        )
    torch.testing.assert_close(first, second, rtol=1e-5, atol=1e-5)
    few = replace(maps, features=maps.features[:, : FEATURES - 2].contiguous())
    with torch.no_grad(), pytest.raises(ValueError, match="cells have 3 features, but the encoder reads 4"):
        predict_on(model, state, torch.zeros(1, 5, 3), MapTerrain(few, *given, model.encoder))
    assert not supports_encoder(model.encoder, few.features.float())
