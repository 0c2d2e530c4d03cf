"""Angles, quaternions and local polynomials against scipy, closed forms and derivatives."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from offpiste.core.geometry import (
    bicycle_angle,
    local_from_geographic,
    local_polynomial,
    planar_body_from_world,
    rotation_from_quaternion,
    rotation_of_one,
    same_sign,
    yaw_from_quaternion,
    yaw_rate_from_body_rates,
)


def test_a_vector_along_the_heading_points_forward_in_the_body():
    yaw = np.array([0.3, -2.0])
    along = np.stack((np.cos(yaw), np.sin(yaw)), axis=1)
    np.testing.assert_allclose(planar_body_from_world(along, yaw), [[1, 0], [1, 0]], atol=1e-12)
    # Heading north: north is ahead, west is left; of a path all points by one heading.
    path = np.array([[[-1.0, 3.0], [0.0, 2.0]]])
    np.testing.assert_allclose(planar_body_from_world(path, np.array([[np.pi / 2]])), [[[3, 1], [2, 0]]], atol=1e-12)


def test_rotations_equal_those_of_scipy_and_of_single_quaternions():
    quaternion = np.random.default_rng(1).normal(size=(500, 4))
    found = rotation_from_quaternion(quaternion)
    np.testing.assert_allclose(found, Rotation.from_quat(quaternion).as_matrix(), atol=1e-12)
    np.testing.assert_array_equal([rotation_of_one(one) for one in quaternion], found)


def test_rotations_of_one_sign_are_the_same_and_lie_on_one_side():
    turning = Rotation.from_euler("z", np.linspace(0, 30, 200)[:, None]).as_quat()
    flipped = turning * np.random.default_rng(2).choice([-1, 1], (200, 1))
    found = same_sign(flipped)
    assert (np.einsum("Nk,Nk->N", found[1:], found[:-1]) > 0).all()
    np.testing.assert_array_equal(np.abs(found), np.abs(flipped))
    np.testing.assert_array_equal(found[0], flipped[0])


def test_yaw_equals_scipys_and_is_unwrapped():
    yaw = np.linspace(0, 20, 200)
    rotation = Rotation.from_euler("ZYX", np.stack((yaw, 0.3 * np.sin(yaw), 0.4 * np.cos(yaw)), axis=1))
    np.testing.assert_allclose(yaw_from_quaternion(rotation.as_quat()), yaw, atol=1e-12)


def test_yaw_rate_from_the_gyro_is_the_derivative_of_yaw_on_any_slope():
    time = np.linspace(0, 10, 2001)
    yaw, pitch, roll = 0.5 * time + np.sin(time), 0.4 * np.sin(0.7 * time), 0.3 * np.cos(1.1 * time)
    rotation = Rotation.from_euler("ZYX", np.stack((yaw, pitch, roll), axis=1))
    step = time[1] - time[0]
    gyro = (rotation[:-2].inv() * rotation[2:]).as_rotvec() / (2 * step)
    found = yaw_rate_from_body_rates(rotation[1:-1].as_quat(), gyro)
    np.testing.assert_allclose(found, 0.5 + np.cos(time[1:-1]), atol=1e-4)
    assert np.abs(gyro[:, 2] - found).max() > 0.1  # the gyro's z is another thing


def uneven(seed: int = 0, count: int = 400, span: float = 8.0) -> np.ndarray:
    """Stamps whose intervals vary from almost none to twice the mean."""
    return span / count * (np.arange(count) + np.random.default_rng(seed).uniform(0, 0.99, count))


@pytest.mark.parametrize("causal", [False, True])
def test_polynomials_are_exact_on_quadratics_with_uneven_stamps(causal):
    time, at = uneven(), np.linspace(0.5, 7.5, 71)
    coefficients = np.array([[1.0, -2.0, 3.0], [0.5, 0.1, -1.0]])
    values = np.stack([np.polyval(c, time) for c in coefficients], axis=1)
    found, rate = local_polynomial(time, values, at, window=0.4, causal=causal)
    np.testing.assert_allclose(found, np.stack([np.polyval(c, at) for c in coefficients], axis=1), atol=1e-8)
    np.testing.assert_allclose(rate, np.stack([np.polyval(np.polyder(c), at) for c in coefficients], 1), atol=1e-6)


@given(st.integers(0, 60))
@settings(max_examples=20, deadline=None)
def test_causal_estimates_do_not_look_ahead(row):
    time, rng = uneven(1, 200, 4.0), np.random.default_rng(0)
    values, at = rng.normal(size=(200, 1)), np.linspace(0.5, 4, 61)
    changed = np.where(time[:, None] > at[row], 1e6, values)
    ours, changed = (local_polynomial(time, v, at[: row + 1], window=0.4, causal=True) for v in (values, changed))
    np.testing.assert_array_equal(ours, changed)


def test_a_bicycle_turns_as_its_angle_says():
    rate, speed = np.array([0.2, -0.5, 0.3, 0.4, 0.0, -0.4, 0.001]), np.array([1.0, 2.0, -1.5, 0.0, 0.0, 0.0, 0.0])
    angle = bicycle_angle(rate, speed, 2.2)
    np.testing.assert_allclose(speed[:3] * np.tan(angle[:3]) / 2.2, rate[:3])
    assert (np.abs(angle[:3]) < np.pi / 2).all()
    np.testing.assert_allclose(np.abs(angle[[3, 5]]), 1.46, atol=0.01)
    np.testing.assert_allclose(angle[[4, 6]], 0.0, atol=0.03)
    assert angle[3] > 0 > angle[5], "on the spot"


def test_gaps_and_bursts_are_neither_extrapolated_nor_filled():
    for spacing in (1e-3, 1e-9):
        burst, values = np.append(spacing * np.arange(5), 9.0), np.random.default_rng(0).normal(0, 0.01, (6, 1))
        found, _ = local_polynomial(burst, values, np.array([0.01, 0.1]), window=0.3, causal=True)
        assert np.isnan(found).all()
    time = 1.7e9 + np.concatenate((np.arange(0, 1, 0.01), [3.0, 3.1, 3.2], np.arange(5, 6, 0.01)))
    at = 1.7e9 + np.array([0.99, 1.2, 3.15, 4.9, 5.5])
    found, rate = local_polynomial(time, 3 * (time - 1.7e9)[:, None], at, window=0.3, causal=True)
    assert np.isfinite(found[:, 0]).tolist() == [True, False, False, False, True]
    np.testing.assert_allclose(rate[[0, 4], 0], 3, atol=1e-5)


def _burst() -> np.ndarray:
    """100 s at 50 Hz, of which 2000 more stamps within a tenth of a second."""
    return np.sort(np.append(np.arange(0, 100, 0.02), 50.001 + np.arange(2000) / 20_000))


@pytest.mark.parametrize("time", [_burst(), np.arange(0, 10, 1e-3)], ids=["a burst", "1 kHz"])
def test_memory_does_not_grow_with_rows_times_the_widest_window(time):
    at = np.linspace(0, time[-1], 5000)
    tracemalloc.start()
    local_polynomial(time, np.sin(time)[:, None], at, window=0.4, causal=False)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 30e6


@pytest.mark.parametrize("causal", [False, True])
def test_a_row_does_not_depend_on_the_others(causal):
    time = _burst()
    values, at = np.random.default_rng(0).normal(size=(len(time), 2)), np.linspace(-1, 101, 3001)
    together = local_polynomial(time, values, at, window=0.4, causal=causal)
    for row in (0, 10, 700, 1490, 1500, 1502, 3000):
        alone = local_polynomial(time, values, at[row : row + 1], window=0.4, causal=causal)
        np.testing.assert_array_equal([both[row] for both in together], [one[0] for one in alone])


def _ellipsoid(place):
    """Earth-centred coordinates of WGS 84: three lines of any textbook of geodesy."""
    latitude, longitude = np.deg2rad(place[:, 0]), np.deg2rad(place[:, 1])
    squared = (2 - 1 / 298.257223563) / 298.257223563
    radius = 6_378_137.0 / np.sqrt(1 - squared * np.sin(latitude) ** 2)
    flat = radius * np.cos(latitude)
    return np.stack((flat * np.cos(longitude), flat * np.sin(longitude), (1 - squared) * radius * np.sin(latitude)), 1)


@given(st.floats(-75, 75), st.floats(-180, 180), st.integers(0, 1000))
def test_geographic_places_keep_their_distances(latitude, longitude, seed):
    step = np.random.default_rng(seed).uniform(-0.005, 0.005, (20, 2))
    place = np.array([latitude, longitude]) + step
    local, exact = local_from_geographic(place), _ellipsoid(place)
    lengths = np.linalg.norm(np.diff(local, axis=0), axis=1)
    np.testing.assert_allclose(lengths, np.linalg.norm(np.diff(exact, axis=0), axis=1), rtol=1e-3, atol=1e-3)


def test_east_and_north_of_the_nearest_hundredth_of_a_degree_or_of_an_origin():
    # A degree at 48 degrees north, from a table of WGS 84: 111.200 km of latitude, 74.628 km of longitude.
    place = np.array([[0, 0, 0], [np.nan, 11, 0], [48.001, 11.002, 520.0], [48.0, 11.0, 521.0], [95.0, 11.0, 0]])
    local = local_from_geographic(place)
    np.testing.assert_allclose(local[2:4], [[149.26, 111.20, 520.0], [0.0, 0.0, 521.0]], atol=0.02)
    np.testing.assert_array_equal(np.isnan(local[:, 0]), [True, True, False, False, True])
    np.testing.assert_array_equal(local_from_geographic(place[3:4]), local[3:4])
    np.testing.assert_array_equal(local_from_geographic(place[::-1], (48.0, 11.0)), local[::-1])
    assert np.isnan(local_from_geographic(np.zeros((2, 2)))).all()


def test_across_the_date_line_a_step_stays_a_step():
    local = local_from_geographic(np.array([[0.001, 179.9999], [0.001, -179.9999]]))
    np.testing.assert_allclose(np.diff(local, axis=0), [[22.26, 0.0]], atol=0.01)
