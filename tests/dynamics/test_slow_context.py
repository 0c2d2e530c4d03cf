"""Slow context: recursive least squares against plain ones, what it learns, and where it stays as it is."""

from dataclasses import replace

import numpy as np
import pytest

from offpiste.core.conventions import ACTUATORS, CONTROL
from offpiste.core.errors import RunError
from offpiste.dynamics import MODELS, Vehicle
from offpiste.dynamics.slow_context import SHIFTED, ContextSettings, SlowContext, shifted

NOISE = np.array([0.2, 0.1, 0.03])
VEHICLE = Vehicle(mass=1200.0, wheelbase=2.1, max_steer=0.5, control=CONTROL, actuators=ACTUATORS)
SETTINGS = ContextSettings(memory=20.0, spread=0.5, doubt=10.0)


def observations(count: int, shift: np.ndarray, seed: int = 0) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Times, errors and derivatives of predictions by a model whose constants are off by a shift."""
    rng, found = np.random.default_rng(seed), []
    for number in range(count):
        jacobian = rng.normal(size=(3, len(SHIFTED))) * NOISE[:, None]
        found.append((0.1 * number, jacobian @ shift + 0.3 * NOISE * rng.normal(size=3), jacobian))
    return found


def test_the_recursion_is_the_least_squares_over_all_that_is_known() -> None:
    context, shift = SlowContext(NOISE, 0.0, SETTINGS), np.array([0.3, -0.2, 0.5, 0.0, -0.4])
    seen = observations(200, shift)
    for one in seen:
        context.add(*one)
    now = 25.0
    information, vector = np.eye(len(shift)) / SETTINGS.spread**2, np.zeros(len(shift))
    for time, error, jacobian in seen:
        scaled = error / NOISE
        huber = np.minimum(1, SETTINGS.outlier / np.abs(scaled))
        weight = np.exp((time - now) / SETTINGS.memory) * huber / SETTINGS.doubt / NOISE**2
        information += jacobian.T @ np.diag(weight) @ jacobian
        vector += jacobian.T @ (weight * error)
    np.testing.assert_allclose(context.shift(now), np.linalg.solve(information, vector), rtol=1e-9)


def test_a_shift_is_learned_and_forgotten() -> None:
    context, shift = SlowContext(NOISE, 0.0, SETTINGS), np.array([0.3, -0.2, 0.5, 0.0, -0.4])
    np.testing.assert_array_equal(context.shift(3.0), 0.0)
    for one in observations(600, shift):
        context.add(*one)
    np.testing.assert_allclose(context.shift(60.0), shift, atol=0.08)
    later = context.shift(60.0 + 10 * SETTINGS.memory)
    assert np.abs(later).max() < 0.01, "nothing was heard for long"


def test_no_shift_beyond_the_limit_and_none_by_errors_that_are_not_finite() -> None:
    context = SlowContext(NOISE, 0.0, replace(SETTINGS, limit=0.1))
    for time, error, jacobian in observations(300, np.full(len(SHIFTED), 5.0)):
        context.add(time, error, jacobian)
        context.add(time, np.array([np.nan, 0.0, 0.0]), jacobian)
        context.add(time, error, np.full_like(jacobian, np.inf))
    assert np.abs(context.shift(30.0)).max() <= 0.1


def test_outliers_hardly_count() -> None:
    clean, dirty = SlowContext(NOISE, 0.0, SETTINGS), SlowContext(NOISE, 0.0, SETTINGS)
    for number, (time, error, jacobian) in enumerate(observations(300, np.zeros(len(SHIFTED)))):
        clean.add(time, error, jacobian)
        dirty.add(time, error + (50 * NOISE if number % 20 == 0 else 0), jacobian)
    assert np.abs(dirty.shift(30.0) - clean.shift(30.0)).max() < 0.15


@pytest.mark.parametrize("name", ["parametric", "b"])
def test_shifted_constants_are_those_of_a_copy(name: str) -> None:
    model = MODELS[name].build(VEHICLE)
    parts = model.kernel_parts()
    assert parts is not None
    before = parts.bicycle()
    other = shifted(model, [0.5, 0.0, -0.5, 0.0, 0.0])
    changed = other.kernel_parts()
    assert changed is not None
    now = changed.bicycle()
    assert float(now.drive_1) > float(before.drive_1)
    assert float(now.resistance) < float(before.resistance)
    same = ("brake_1", "brake_2", "rear_peak", "front_peak", "yaw_gain", "drag_x", "gravity_x", "min_slip_speed")
    assert all(float(getattr(now, field)) == float(getattr(before, field)) for field in same)
    assert parts.bicycle() == before, "the model itself stays as it is"


def test_a_model_without_constants_is_refused() -> None:
    with pytest.raises(RunError, match="no physical constants"):
        shifted(MODELS["kinematic"].build(VEHICLE), np.zeros(len(SHIFTED)))
