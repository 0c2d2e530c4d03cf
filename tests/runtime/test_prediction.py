"""Part of the map that a plan reads, by hand."""

import dataclasses

import numpy as np
import pytest
import torch

from offpiste.dynamics.feature_encoder import Compressor
from offpiste.runtime import prediction
from offpiste.runtime.estimator import TrackRows
from offpiste.runtime.prediction import coded_area, model_state_after, model_state_of
from planning.test_kernel import model, start
from planning_maps import layers, situation
from runtime.stream import parametric

ORIGIN = torch.zeros(2, dtype=torch.float64)


@pytest.fixture
def encoder():
    torch.manual_seed(0)
    return Compressor(2).eval().requires_grad_(False)


def at(area, x, y):
    """Codes under a wheel at a place."""
    state = torch.tensor([[x, y, 0.0, 0.0, 0.0, 0.0]])
    return area.terrain(ORIGIN, torch.zeros(4, 2), 1).at(0, state).latent[0, 0]


def test_a_map_of_codes_is_read_as_it_is(encoder):
    codes = np.random.default_rng(0).normal(size=(81, 81, encoder.size)).astype(np.float32)
    codes[42, 41] = np.nan
    area = coded_area(layers(features=codes), encoder)
    torch.testing.assert_close(at(area, 1.0, 0.5), torch.from_numpy(codes[41, 42]))
    torch.testing.assert_close(at(area, 0.5, 1.0), encoder.missing())
    torch.testing.assert_close(at(area, 90.0, 0.0), encoder.missing())
    torch.testing.assert_close(area.codes[0][42, 41], encoder.missing())


def test_known_ground_is_encoded_where_it_lies(encoder):
    area = coded_area(layers(), encoder, lambda places: places * (0.1, 0.01))
    code = encoder(torch.tensor([[0.3, -0.1]]), torch.ones(1, dtype=torch.bool))[0]
    torch.testing.assert_close(at(area, 3.0, -10.0), code)


@pytest.mark.parametrize("kind", ["parametric", "dc", "df"])
def test_committed_controls_are_stepped_alike_with_and_without_the_kernel(kind, monkeypatch):
    dynamics = model(kind)
    if kind != "parametric":
        torch.nn.init.normal_(dynamics.compensator.output[-1].weight, std=1.0)
    seen = layers(features=np.random.default_rng(0).normal(size=(81, 81, 3)).astype(np.float32))
    area = coded_area(seen, getattr(dynamics, "encoder", None))
    here = dataclasses.replace(situation(seen, state=(0.0, 0, 0.3, 8, 0, 0)), ground=area.stack)
    controls = torch.tensor([[0.5, 0.0, 0.2]]).repeat(20, 1)
    by_kernel = model_state_after(dynamics, start(dynamics, here), controls, area, here).state
    monkeypatch.setattr(prediction, "_by_kernel", lambda *_: False)
    stepped = model_state_after(dynamics, start(dynamics, here), controls, area, here).state
    torch.testing.assert_close(by_kernel, stepped, atol=1e-3, rtol=1e-3)


def test_models_without_features_read_none():
    area = coded_area(layers(), None)
    assert area.encode is None
    assert at(area, 0.0, 0.0).shape == (0,)


def test_the_past_is_read_in_the_gear_that_it_was_driven_in(monkeypatch):
    model, given = parametric("gear"), []
    gears = np.array([np.nan, -1.0, -1.0, *8 * [1.0]])
    rows = TrackRows(np.zeros((11, 6)), np.full((11, 4), np.nan), np.full((11, 3), 0.5), gears)
    start = model.start
    monkeypatch.setattr(
        model, "start", lambda history, *rest: given.append(history.control[0]) or start(history, *rest)
    )
    model_state_of(model, rows, coded_area(layers(), None), torch.zeros(4, 2), ORIGIN, -1.0)
    assert given[0].tolist() == [[0.5, 0.5, 0.5, gear] for gear in (-1, -1, -1, *7 * [1])]
