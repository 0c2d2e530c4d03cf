from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from factories import COMMANDED, RIG, circle_rows
from offpiste.conventions import DT
from offpiste.dataset.splits import Split
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dataset.windows import Windows
from offpiste.dynamics import ConstantMotion
from offpiste.evaluation.errors import predict, trajectories
from offpiste.rig.rig import parse_rig
from offpiste.state import ModelState

SCALE, WEIGHTS = torch.tensor([4.0, 1.0, 1.0, 1.0, 1.0]), torch.ones(5)


def circling(start: str = "smoothed", rows: int = 600, **change) -> Windows:
    drive = StoredDrive("circle", replace(circle_rows(rows), **change), np.full(rows, 2, dtype=np.int8), ())
    split = Split("all", "drives", drives=(("circle", "test"),))
    return Windows(Dataset(Path("nowhere"), parse_rig(RIG, where="test"), split, (drive,)), "test", start=start)


class Off(ConstantMotion):
    """Constant motion whose states are off by a given amount at every step after the first."""

    def __init__(self, by: list[float]) -> None:
        super().__init__(COMMANDED)
        self.by = torch.tensor(by)

    def stepper(self):
        move = super().stepper()

        def step(model_state, control, terrain):
            moved = move(model_state, control, terrain)
            return ModelState(moved.state + self.by, moved.actuators, moved.hidden, moved.cell)

        return step


def test_a_perfect_model_has_no_errors() -> None:
    """A circle at constant speed is what `ctrv` assumes; forward Euler leaves the polygon's error."""
    windows = circling()
    found = predict(ConstantMotion(COMMANDED), windows, windows.every(50), lookup=None, scale=SCALE, weights=WEIGHTS)
    assert found.values[..., 0].max() < 0.15
    assert found.values[..., 1:].max() < 1e-4
    assert not found.failed.any()


def test_errors_by_horizon_worked_by_hand() -> None:
    """Off by 0.001 rad a step: 0.05 rad after 1 s, 0.25 after 5 s; -0.004 m/s a step: 1 m/s after 5 s."""
    windows = circling()
    model = Off([0.0, 0.0, 0.001, 0.0, -0.004, 0.0])
    found = predict(model, windows, windows.every(100), lookup=None, scale=SCALE, weights=WEIGHTS)
    seconds = np.arange(1, 6)
    np.testing.assert_allclose(
        found.values[:, :, 1], np.broadcast_to(0.05 * seconds, found.values.shape[:2]), atol=1e-4
    )
    np.testing.assert_allclose(found.values[:, :, 3], np.broadcast_to(0.2 * seconds, found.values.shape[:2]), atol=1e-4)
    np.testing.assert_allclose(found.values[:, :, 2], 0.0, atol=1e-4)


def test_distance_and_loss_of_a_standing_prediction() -> None:
    """It stays at the start: the distance error is the chord, and the loss sums squared errors over their scales."""
    windows = circling()
    index = windows.every(100)

    class Parked(ConstantMotion):
        def stepper(self):
            return lambda model_state, control, terrain: model_state

    found = predict(Parked(COMMANDED), windows, index, lookup=None, scale=SCALE, weights=WEIGHTS)
    seconds = np.arange(1, 6)
    chord = 2 * 10.0 * np.sin(0.5 * seconds / 2)  # radius 10 m, 0.5 rad/s
    np.testing.assert_allclose(found.values[:, :, 0], np.broadcast_to(chord, found.values.shape[:2]), rtol=1e-4)
    t = DT * np.arange(1, 251)
    loss = ((20 * np.sin(t / 4)) ** 2 / 4 + (0.5 * t) ** 2).mean()
    np.testing.assert_allclose(found.loss, loss, rtol=1e-3)


def test_yaw_is_compared_around_the_circle() -> None:
    """A model that turns by a whole circle more than the vehicle faces the same way."""
    windows = circling()
    found = predict(
        Off([0, 0, 2 * np.pi / 250, 0, 0, 0]), windows, windows.every(200), lookup=None, scale=SCALE, weights=WEIGHTS
    )
    assert found.values[:, 4, 1].max() < 1e-3
    np.testing.assert_allclose(found.values[:, 1, 1], 4 * np.pi / 5, atol=1e-3)
    np.testing.assert_allclose(found.values[:, 3, 1], 2 * np.pi / 5, atol=1e-3)


def test_chunks_do_not_matter_and_windows_keep_their_identity() -> None:
    windows = circling("causal")
    index = windows.every(20)[::-1]
    whole, pieces = (
        predict(ConstantMotion(COMMANDED), windows, index, lookup=None, scale=SCALE, weights=WEIGHTS, chunk=chunk)
        for chunk in (1000, 3)
    )
    np.testing.assert_allclose(whole.values, pieces.values, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(whole.loss, pieces.loss, rtol=1e-4)
    assert whole.row.tolist() == windows.row_in_drive(index).tolist()


def test_progress_is_told_by_chunk() -> None:
    windows = circling()
    told = []

    def track(items, description):
        for item in items:
            told.append((description, len(item)))
            yield item

    index = windows.every(40)
    predict(
        ConstantMotion(COMMANDED),
        windows,
        index,
        lookup=None,
        scale=SCALE,
        weights=WEIGHTS,
        chunk=4,
        track=track,
        description="judging x",
    )
    assert {name for name, _ in told} == {"judging x"}
    assert sum(size for _, size in told) == len(index)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_prediction_that_diverges_is_infinitely_wrong_from_then_on(value: float) -> None:
    class Diverging(ConstantMotion):
        steps = 0

        def stepper(self):
            move, self.steps = super().stepper(), 0

            def step(model_state, control, terrain):
                self.steps += 1
                moved = move(model_state, control, terrain)
                broken = moved.state.clone()
                if self.steps > 120:
                    broken[0, 5] = value
                return ModelState(broken, moved.actuators, moved.hidden, moved.cell)

            return step

    windows = circling()
    found = predict(Diverging(COMMANDED), windows, windows.every(100), lookup=None, scale=SCALE, weights=WEIGHTS)
    assert found.failed[0].tolist() == [False, False, True, True, True]
    assert (found.values[0, 2:] == np.inf).all()
    assert found.loss[0] == np.inf
    assert not found.failed[1:].any()
    assert np.isfinite(found.values[1:]).all()


def test_trajectories_are_those_that_were_judged() -> None:
    windows = circling()
    index = windows.every(60)
    model = Off([0.001, 0, 0, 0, 0, 0])
    states = trajectories(model, windows, index, lookup=None)
    found = predict(model, windows, index, lookup=None, scale=SCALE, weights=WEIGHTS)
    target = windows.gather(index).target.numpy()
    np.testing.assert_allclose(
        np.linalg.norm(states[:, -1, :2] - target[:, -1, :2], axis=1), found.distance(), rtol=1e-5, atol=1e-6
    )


def test_no_windows_have_no_trajectories() -> None:
    # A fold may hold none of the worst windows.
    windows = circling()
    model = ConstantMotion(COMMANDED)
    assert trajectories(model, windows, np.zeros(0, dtype=np.int64), lookup=None).shape == (0, windows.horizon, 6)
