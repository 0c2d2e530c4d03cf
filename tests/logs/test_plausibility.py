"""Plausible poses: fault-free drives stay whole, injected runs are dropped exactly, the chain is optimal."""

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from offpiste.logs.plausibility import best_chain, held_while_driving, plausible

RUNS = ("glitches", "constant", "random", "long constant", "fast tail", "fast head", "coherent")


def driven(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return stamps, positions and yaw of a random drive: slow or fast, spinning, standing, noisy, held, or late."""
    rng = np.random.default_rng(seed)
    rate = float(rng.choice([1, 5, 10, 20, 50, 100, 200, 1000]))
    speed = min(float(rng.choice([0, 0.5, 2, 5, 15, 40, 80])), 40 * rate)
    turn = min(float(rng.choice([0, 0.3, 1, 8])), 15 / max(speed, 1))
    noise, hold = float(rng.choice([0, 1e-3, 0.02, 0.2, 1.0])), int(rng.choice([1, 1, 5, 10]))
    time, place, yaw = path(rng, rate, speed, turn, noise, seconds=10 if rate == 1000 else 40)
    if hold > 1 and rate >= 50:
        kept = np.arange(len(time)) // hold * hold
        place, yaw = place[kept], yaw[kept]
    if rng.random() < 0.3:
        for at in rng.integers(0, len(time) - 10, 10):
            end = int(min(rate * 0.5, len(time) - at - 1)) + at
            time[at:end] = np.linspace(time[end] - 1e-3, time[end], end - at, endpoint=False)
        time = np.maximum.accumulate(time) + np.arange(len(time)) * 1e-7
    return time, place, yaw


def path(rng, rate, speed, turn, noise, seconds=60.0):
    time = np.arange(int(rate * seconds)) / rate
    phase = rng.uniform(0, 2 * np.pi, 2)
    v = speed * np.clip(0.6 + 0.7 * np.sin(4 / max(speed, 1) * time + phase[0]), 0, None)
    yaw = np.cumsum(turn * np.sin(0.7 * time + phase[1])) / rate
    xy = np.cumsum(v[:, None] * np.column_stack((np.cos(yaw), np.sin(yaw))), axis=0) / rate
    place = np.column_stack((xy, 0.5 * np.sin(xy[:, 0] / 10))) + rng.normal(0, noise, (len(time), 3))
    far = rng.uniform(-1e6, 1e6, 3) * (rng.random() < 0.5)
    return time, place + far, yaw + rng.normal(0, noise / 5, len(time))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_a_healthy_drive_loses_no_sample(seed: int) -> None:
    time, place, yaw = driven(seed)
    turned = Rotation.from_euler("z", yaw[:, None]).as_quat()
    wrapped = (yaw[:, None] + np.pi) % (2 * np.pi) - np.pi
    channels = [("position", place), ("position", place[:, :2]), ("yaw", yaw[:, None]), ("yaw", wrapped)]
    for name, values in [*channels, ("orientation", turned)]:
        each = plausible(name, time, values)
        assert each.keep.all()
        assert not len(each.jumps)
        assert not each.hopeless
    assert not held_while_driving(time, place).any()


@pytest.mark.parametrize("hold", [1, 5])
@pytest.mark.parametrize("stands", [False, True])
def test_a_place_that_hangs_while_the_vehicle_drives_on_is_held(hold: int, stands: bool) -> None:
    """Also where it hangs at a standstill, and the vehicle drives off meanwhile; not where it stands and waits."""
    time = np.arange(3000) / 50.0
    speed = np.clip(time - 30.0, 0.0, 4.0) if stands else np.full(len(time), 4.0)
    place = np.cumsum(speed)[:, None] / 50 * [0.6, 0.8]
    place = place[np.arange(len(time)) // hold * hold]
    assert not held_while_driving(time, place).any()
    first, end = 1400, 1900  # the vehicle drives off at 1500
    hanging = place.copy()
    hanging[first:end] = place[first]
    assert np.linalg.norm(place[end] - place[first]) > 10
    held = held_while_driving(time, hanging)
    assert held[first + hold : end].all()
    assert not held[end:].any()
    assert stands or not held[:first].any()


@pytest.mark.parametrize("hold", [1, 5])
@pytest.mark.parametrize(("braking", "held_to_the_end"), [(1e6, True), (8.0, False)])
def test_a_place_that_hangs_to_the_end_is_held_unless_the_vehicle_can_have_stopped(hold, braking, held_to_the_end):
    time = np.arange(3000) / 50.0
    place = np.cumsum(np.clip(braking * (40.0 - time), 0.0, 4.0))[:, None] / 50 * [0.6, 0.8]
    held = held_while_driving(time, place[np.arange(len(time)) // hold * hold])
    assert held[2000 + hold :].all() if held_to_the_end else not held.any()
    assert not held[:2000].any()


def planted(kind: str, rng: np.random.Generator, time: np.ndarray, place: np.ndarray, speed: float):
    """Return the drive with corrupt samples, and a mask of good ones."""
    count, result, good = len(time), place.copy(), np.ones(len(time), bool)
    first, length = int(rng.integers(20, count - 150)), int(rng.integers(2, 86))
    run = slice(first, first + length)
    if kind == "glitches":
        for at in rng.choice(np.arange(20, count - 20, 7), 5, replace=False):
            aside = rng.normal(size=3)
            result[at] += aside / np.linalg.norm(aside[:2]) * (max(5, speed / 2) + rng.uniform(0, 1e4))
            good[at] = False
        return result, good
    if kind == "constant":
        result[run] = place.mean(axis=0) + 1e4
    elif kind == "random":
        result[run] += rng.normal(0, 1e5, (length, 3))
    elif kind == "coherent":
        result[run] += (300.0, 100.0, 0.0)
    elif kind == "long constant":
        run = slice(count // 3, 2 * count // 3)
        result[run] = place.mean(axis=0) + 2000
    else:
        run = slice(3 * count // 4, count) if kind == "fast tail" else slice(0, count // 4)
        edge = run.start - 1 if kind == "fast tail" else run.stop
        result[run, 0] += 571 * (time[run] - time[edge])
    good[run] = False
    return result, good


@pytest.mark.parametrize("kind", RUNS)
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_planted_runs_are_dropped_and_nothing_else(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    speed = float(rng.choice([2, 5, 15]))
    noise = float(rng.choice([1e-3, 0.02, 0.05]))
    time, place, _ = path(rng, float(rng.choice([10, 20, 50, 100])), speed, min(1.0, 15 / speed), noise)
    corrupt, good = planted(kind, rng, time, place, speed)
    for axes in (2, 3):
        found = plausible("position", time, corrupt[:, :axes])
        np.testing.assert_array_equal(found.keep, good)
        assert not len(found.jumps)


@pytest.mark.parametrize(
    ("at", "shifts"),
    [([3000], [8.0]), ([3000], [500.0]), ([1500, 1551], [1.0, 0.7])],  # two corrections in a second
)
def test_a_shift_that_lasts_stays_as_a_jump(at: list[int], shifts: list[float]) -> None:
    time, place, _ = path(np.random.default_rng(1), 50, 5, 0.3, 0.001, seconds=120)
    for row, shift in zip(at, shifts, strict=True):
        place[row:, 1] += shift
    found = plausible("position", time, place)
    assert found.keep.all()
    assert [number for number, _ in found.jumps] == at
    np.testing.assert_allclose([size for _, size in found.jumps], shifts, atol=0.1)


@pytest.mark.parametrize("as_quaternion", [False, True])
def test_glitches_of_the_heading_are_dropped_and_a_lasting_step_is_a_jump(as_quaternion: bool) -> None:
    time, _, yaw = path(np.random.default_rng(3), 50, 5, 1.0, 0.005)
    yaw[700] += 0.4
    yaw[1200:1220] -= 1.0
    yaw[2000:] += 0.4
    yaw = (yaw[:, None] + np.pi) % (2 * np.pi) - np.pi
    heading = Rotation.from_euler("z", yaw).as_quat() * np.where(time < 30, 1, -1)[:, None] if as_quaternion else yaw
    found = plausible("orientation" if as_quaternion else "yaw", time, heading)
    assert np.flatnonzero(~found.keep).tolist() == [700, *range(1200, 1220)]
    assert [number for number, _ in found.jumps] == [2000]


def test_a_fast_spin_at_a_low_rate_is_no_fault() -> None:
    time = np.arange(0, 30, 0.05)
    yaw = np.cumsum(np.where((time > 10) & (time < 12), 9.0, 0.5)) * 0.05
    found = plausible("yaw", time, yaw[:, None])
    assert found.keep.all()
    assert not len(found.jumps)


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 9))
def test_the_chain_is_the_best_of_all(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    weight, table = rng.uniform(0.1, 3, count), rng.choice([0.0, 0.5, 2.0, 5.0], (count, count))

    def worth(chain: tuple[int, ...]) -> float:
        return float(weight[list(chain)].sum() - sum(table[a, b] for a, b in pairwise(chain)))

    chain = best_chain(weight, lambda origins, to: table[origins, to])
    every = [c for size in range(1, count + 1) for c in combinations(range(count), size)]
    assert worth(tuple(chain.tolist())) == pytest.approx(max(map(worth, every)))


def test_few_samples_are_all_kept() -> None:
    for count in range(1, 10):
        time = np.arange(count, dtype=float)
        assert plausible("position", time, 1e6 * np.random.default_rng(0).normal(size=(count, 3))).keep.all()
