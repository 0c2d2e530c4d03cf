"""Choice of feature sets in training, and their recording against brute force that keeps every map."""

import numpy as np
import pytest

from offpiste.core.conventions import FEATURE_SETS
from offpiste.dataset.feature_sets import TOLERANCE, FeatureSetRecorder, drawn, per_trajectory
from offpiste.dataset.wheel_passes import PAUSE, find_passes
from offpiste.mapping.voxels_to_layers import MapCells

STORED = len(FEATURE_SETS)


def test_dc_keeps_a_set_for_the_trajectory_and_draws_all_alike():
    choice = drawn(per_trajectory, np.random.default_rng(0), 8000, STORED)
    assert choice.features.shape == (8000, 1)
    np.testing.assert_array_equal(choice.features[:, 0], choice.normals)
    counts = np.bincount(choice.normals, minlength=STORED)
    assert len(counts) == STORED
    assert np.abs(counts - 1000).max() < 5 * np.sqrt(1000)


WHEELS = np.array([[0.5, 0.3], [0.5, -0.3], [-0.5, 0.3], [-0.5, -0.3]])
RESOLUTION, REACH = 0.5, 48.0


def there_and_back() -> tuple[np.ndarray, np.ndarray]:
    """Times and positions of a drive of 70 m along x and back on the same line, at 4 m/s."""
    x = np.concatenate((np.arange(70.0), np.arange(70.0)[::-1]))
    return 0.25 * np.arange(len(x)), np.column_stack((x, np.zeros_like(x)))


def passes_of(time: np.ndarray, xy: np.ndarray):
    return find_passes(time, xy, xy[:, None] + WHEELS, resolution=RESOLUTION)


class ChangingMap:
    """Every cell's value tells the cell and the moment; features, elevation and normal are missing at some moments."""

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def at(self, step: int):
        def read(cells: np.ndarray) -> MapCells:
            column, row = cells.T
            mixed = (column * 7919 + row * 104729 + step * 31 + self.seed) % 97
            valid = mixed % 3 > 0
            value = np.where(valid, mixed.astype(float), np.nan)
            elevation = np.where(mixed % 5 > 0, mixed / 4.0, np.nan)
            slope = np.where(mixed % 7 > 1, mixed / 100.0, np.nan)
            normal = np.column_stack((0 * slope, np.sin(slope), np.cos(slope)))
            numbers = (part.astype(np.float32) for part in (elevation, normal, value[:, None], mixed / 2.0))
            return MapCells(*numbers, np.isfinite(elevation), valid)

        return read


def brute_force(time, xy, passes, changing: ChangingMap):
    """By pass, set and quantity: the step (or None) it is from; nothing shared with the code but the definition."""
    chosen = {}
    for p in range(len(passes.contact)):
        centre = (passes.cell[p] + 0.5) * RESOLUTION
        steps, left = [], False
        for step, t in enumerate(time):
            if not passes.approach[p] <= t < passes.end[p]:
                continue
            inside = max(abs(centre - xy[step])) <= REACH
            left = left or (not inside and t > passes.contact[p])
            if inside and not left:
                steps.append(step)
        signed = {s: np.hypot(*(centre - xy[s])) * (-1 if time[s] > passes.contact[p] else 1) for s in steps}
        for number, name in enumerate(FEATURE_SETS):
            near = [s for s in steps if name != "hindsight" and abs(signed[s] - float(name)) <= TOLERANCE]
            held = [(s, changing.at(s)(passes.cell[p : p + 1])) for s in steps] if name == "hindsight" else []
            for quantity in ("features", "elevation", "normal"):
                if name == "hindsight":
                    known = [s for s, values in held if np.isfinite(getattr(values, quantity)).all()]
                    chosen[p, number, quantity] = known[-1] if known else None
                else:
                    nearest = min(near, key=lambda s: abs(signed[s] - float(name))) if near else None
                    chosen[p, number, quantity] = nearest
    return chosen


def test_every_set_holds_what_brute_force_finds():
    time, xy = there_and_back()
    passes, changing = passes_of(time, xy), ChangingMap(0)
    recorder = FeatureSetRecorder(passes, resolution=RESOLUTION, reach=REACH, features=1)
    for step in range(len(time)):
        recorder.update(time[step], xy[step], changing.at(step))
    wanted = brute_force(time, xy, passes, changing)
    assert any(step is None for step in wanted.values())
    assert any(
        len({wanted[p, 0, q] for q in ("features", "elevation", "normal")}) == 3 for p in range(len(passes.cell))
    )
    for (p, number, quantity), step in wanted.items():
        found = getattr(recorder, quantity)[number, p]
        if step is None:
            assert np.isnan(found).all()
            continue
        held = changing.at(step)(passes.cell[p : p + 1])
        np.testing.assert_array_equal(found, getattr(held, quantity)[0].astype(found.dtype))
        if quantity == "features":
            assert recorder.valid[number, p] == held.valid[0]
            assert recorder.distance[number, p] == pytest.approx(held.distance[0])


def test_a_second_pass_begins_after_a_pause_and_does_not_leak_into_the_first():
    time, xy = there_and_back()
    passes = passes_of(time, xy)
    index = passes.index
    under = (passes.cell[index[:, 0]] + 0.5) * RESOLUTION
    np.testing.assert_allclose(under, xy + WHEELS[0], atol=RESOLUTION / 2 + 1e-9)
    cells, counts = np.unique(passes.cell, axis=0, return_counts=True)
    # Near the turn the vehicle is back within the pause; at the start it is not.
    assert counts[cells[:, 0] * RESOLUTION < 40].max() == 2
    turned = time[len(time) // 2]
    near = cells[:, 0] * RESOLUTION > 70 - 4.0 * PAUSE / 2 + 4
    assert (counts[near] == 1).all()
    second = np.isfinite(passes.end)
    assert (passes.end[second] > turned).all()
    # The approach to the second pass begins at the far end, not at the departure from the first.
    later = (passes.contact > turned) & (passes.approach > 0)
    np.testing.assert_allclose(passes.approach[later], turned, atol=0.2)
    assert (passes.approach <= passes.contact).all()
