"""Prediction errors after each second, pooled over runs, and their files."""

from pathlib import Path

import numpy as np
import pytest
import torch

from factories import COMMANDED, circle_rows, dataset_in_memory
from offpiste.core.conventions import DT
from offpiste.core.errors import RunError
from offpiste.dataset.splits import Split
from offpiste.dataset.windows import Windows
from offpiste.dynamics import ConstantMotion, Dynamics
from offpiste.evaluation.errors import (
    Errors,
    by_seed,
    errors_of_models,
    load_errors,
    pool,
    positions,
    save_errors,
    trajectories,
)
from offpiste.training import prediction
from window_errors import BASE, changed

SCALE = torch.tensor([4.0, 1.0, 1.0, 1.0, 1.0])


def circling(start: str = "smoothed") -> Windows:
    split = Split("all", "drives", drives=(("circle", "test"),))
    return Windows(dataset_in_memory({"circle": circle_rows(600)}, split), "test", start=start)


def off(*by: float) -> Dynamics:
    """Constant motion whose states are off by a given amount at every step."""
    return changed(ConstantMotion, lambda moved, before, step: moved + torch.tensor(by))


def errors_of(model: Dynamics, windows: Windows, index: np.ndarray | None = None) -> Errors:
    index = windows.every(100) if index is None else index
    (found,) = errors_of_models([(model, torch.ones(5))], windows, index, lookup=None, scale=SCALE)
    return found


def test_a_perfect_model_has_no_errors() -> None:
    """A circle at constant speed is what `ctrv` assumes; forward Euler leaves the polygon's error."""
    found = errors_of(ConstantMotion(COMMANDED), circling())
    assert found.values[..., 0].max() < 0.15
    assert found.values[..., 1:].max() < 1e-4
    assert not found.failed.any()


def test_errors_by_horizon_worked_by_hand() -> None:
    """Off by 0.001 rad a step: 0.05 rad after 1 s, 0.25 after 5 s; -0.004 m/s a step: 1 m/s after 5 s."""
    windows = circling()
    found = errors_of(off(0.0, 0.0, 0.001, 0.0, -0.004, 0.0), windows)
    for component, rate in ((1, 0.05), (2, 0.0), (3, 0.2)):
        wanted = np.broadcast_to(rate * np.arange(1, 6), found.values.shape[:2])
        np.testing.assert_allclose(found.values[:, :, component], wanted, atol=1e-4)
    around = errors_of(off(0, 0, 2 * np.pi / 250, 0, 0, 0), windows)
    np.testing.assert_allclose(around.values[0, :, 1], np.array([2, 4, 4, 2, 0]) * np.pi / 5, atol=1e-3)


def test_distance_and_loss_of_a_standing_prediction() -> None:
    """It stays at the start: the distance error is the chord, and the loss sums squared errors over their scales."""
    found = errors_of(changed(ConstantMotion, lambda moved, before, step: before), circling())
    seconds = np.arange(1, 6)
    chord = 2 * 10.0 * np.sin(0.5 * seconds / 2)  # radius 10 m, 0.5 rad/s
    np.testing.assert_allclose(found.values[:, :, 0], np.broadcast_to(chord, found.values.shape[:2]), rtol=1e-4)
    t = DT * np.arange(1, 251)
    loss = ((20 * np.sin(t / 4)) ** 2 / 4 + (0.5 * t) ** 2).mean()
    np.testing.assert_allclose(found.loss, loss, rtol=1e-3)


def test_chunks_do_not_matter_and_windows_keep_their_identity(monkeypatch: pytest.MonkeyPatch) -> None:
    windows = circling("causal")
    index = windows.every(20)[::-1]
    whole = errors_of(ConstantMotion(COMMANDED), windows, index)
    monkeypatch.setattr(prediction, "AT_ONCE", 3)
    pieces = errors_of(ConstantMotion(COMMANDED), windows, index)
    np.testing.assert_allclose(whole.values, pieces.values, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(whole.loss, pieces.loss, rtol=1e-4)
    assert whole.row.tolist() == windows.row_in_drive(index).tolist()


def test_a_prediction_that_diverges_has_infinite_errors_from_then_on() -> None:
    def diverge(moved: torch.Tensor, before: torch.Tensor, step: int) -> torch.Tensor:
        broken = moved.clone()
        broken[0, 5] += torch.nan if step > 120 else 0.0
        return broken

    found = errors_of(changed(ConstantMotion, diverge), circling())
    assert found.failed[0].tolist() == [False, False, True, True, True]
    assert (found.values[0, 2:] == np.inf).all()
    assert found.loss[0] == np.inf
    assert not found.failed[1:].any()
    assert np.isfinite(found.values[1:]).all()


def test_trajectories_have_the_evaluated_errors() -> None:
    windows, model = circling(), off(0.001, 0, 0, 0, 0, 0)
    index = windows.every(60)
    states = trajectories(model, windows, index, lookup=None)
    found = errors_of(model, windows, index)
    away = np.linalg.norm(states[:, -1, :2] - windows.gather(index).target.numpy()[:, -1, :2], axis=1)
    np.testing.assert_allclose(away, found.distance(), rtol=1e-5, atol=1e-6)
    assert trajectories(model, windows, index[:0], lookup=None).shape == (0, windows.horizon, 6)


def errors(windows: list[tuple[int, int]], value: float) -> Errors:
    drive, row = np.array(windows).T
    return Errors(drive, row, np.full((len(row), 5, 5), value), np.full(len(row), 10 * value))


def test_runs_are_averaged_window_by_window_and_folds_concatenated() -> None:
    windows = [(0, 10), (0, 15), (1, 10)]
    both = pool([errors(windows, 1.0), errors(windows[::-1], 4.0)])
    assert list(zip(both.drive, both.row, strict=True)) == windows
    assert (both.values == 2.5).all()
    assert (both.loss == 25.0).all()
    runs = [errors([(1, 20)], 1.0), errors([(0, 2)], 2.0), errors([(1, 20)], 3.0), errors([(0, 2)], np.inf)]
    assert pool(runs).row.tolist() == [2, 20]
    assert pool(runs).distance().tolist() == [np.inf, 2.0]
    assert pool(runs).failed[:, -1].tolist() == [True, False]


def test_positions_find_windows_and_refuse_strangers() -> None:
    among, some, other = (
        by_seed([errors(windows, 1.0)], [0]) for windows in ([(0, 1), (0, 5), (2, 0)], [(0, 5), (2, 0)], [(1, 0)])
    )
    assert positions(some, among).tolist() == [1, 2]
    with pytest.raises(AssertionError, match="not the same windows"):
        positions(other, among)


def test_errors_are_stored_and_damaged_files_are_named(tmp_path: Path) -> None:
    backwards, path = BASE.take(np.arange(len(BASE.row))[::-1]), tmp_path / "run" / "map.safetensors"
    save_errors(path, backwards)
    for name in ("drive", "row", "values", "loss"):
        np.testing.assert_array_equal(getattr(load_errors(path), name), getattr(backwards, name))
    path.write_bytes(b"cut")
    for damaged in (path, tmp_path / "map.safetensors"):
        with pytest.raises(RunError, match=r"map\.safetensors: cannot be read"):
            load_errors(damaged)
