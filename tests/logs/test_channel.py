"""Channels of known signals: interpolation, cleaning, conversion, rows of slow sensors, increasing stamps, axes."""

from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from factories import MemoryLog, small_rig
from offpiste.core.errors import LogError, OffpisteError
from offpiste.logs.channel import (
    Channel,
    between_samples,
    brought_together,
    convert,
    increasing,
    read_channel,
    refuse_long,
    to_z_up,
    turning_sign,
)
from offpiste.logs.drive import common_span
from offpiste.rig.channels import ChannelSource, Wrap

SMALL = small_rig()


def channel(time, values) -> Channel:
    return Channel("throttle", "1", np.asarray(time, float), np.asarray(values, float).reshape(len(time), -1))


def read(time, numbers, name="throttle", rig=SMALL, **source):
    """Read a channel, with notes, from columns of numbers."""
    columns = np.asarray(numbers, float).reshape(len(time), -1)
    fields = tuple("xyzw"[: columns.shape[1]])
    log = MemoryLog(topic=(np.asarray(time, float), dict(zip(fields, columns.T, strict=True))))
    channel, _, notes = read_channel(log, rig, name, ChannelSource(fields=fields, topic="topic", **source))
    return channel, notes


def test_linear_interpolation_is_exact_on_lines_and_hold_gives_the_last_value():
    time, at = np.array([0.0, 0.1, 0.15, 0.4, 0.5]), np.linspace(0, 0.5, 26)
    found = channel(time, np.stack((2 * time + 1, -time), axis=1)).linear(at, max_gap=1.0)
    np.testing.assert_allclose(found, np.stack((2 * at + 1, -at), axis=1))
    held = channel([0.0, 1.0, 2.0], [5.0, 6.0, 7.0]).hold(np.array([0.0, 0.99, 1.0, 1.5, 2.0]), max_gap=2.0)
    assert held[:, 0].tolist() == [5, 5, 6, 6, 7]


def test_a_value_that_is_kept_up_is_repeated_until_the_next_and_to_the_end():
    kept = channel([0.0, 0.1, 2.0, 2.05], [5.0, 6.0, 7.0, 8.0]).kept_up(3.0, every=0.4)
    at = np.array([-0.1, 0.0, 0.05, 0.1, 1.0, 1.99, 2.0, 2.06, 2.7, 3.0, 3.01])
    np.testing.assert_array_equal(kept.hold(at, max_gap=0.4)[:, 0], [np.nan, 5, 5, 6, 6, 6, 7, 8, 8, 8, np.nan])
    np.testing.assert_array_equal(kept.latest(at[:-1], max_gap=0.4)[:, 0], [np.nan, 5, 5, 6, 6, 6, 7, 8, 8, 8])
    assert (np.diff(kept.time) > 0).all()
    assert np.diff(kept.time).max() <= 0.4
    assert {0.0, 0.1, 2.0, 2.05, 3.0} <= set(kept.time)


def test_latest_does_not_look_whether_another_sample_follows():
    at = np.array([0.99, 1.0, 1.1, 1.5, 1.75, 2.0, 3.4])
    found = channel([1.0, 1.1, 3.0], [1.0, 2.0, 3.0]).latest(at, max_gap=0.5)[:, 0]
    np.testing.assert_array_equal(found, [np.nan, 1, 2, 2, np.nan, np.nan, 3])
    np.testing.assert_array_equal(channel([1.0, 1.1], [1.0, 2.0]).latest(at[:5], max_gap=0.5)[:, 0], found[:5])


@pytest.mark.parametrize("how", ["linear", "hold"])
def test_outside_the_record_and_in_gaps_nothing_is_known(how):
    signal = channel([1.0, 1.1, 3.0, 3.1], [1.0, 1.0, 2.0, 2.0])
    found = getattr(signal, how)(np.array([0.99, 1.0, 1.05, 2.0, 3.05, 3.1, 3.11]), max_gap=0.5)
    assert np.isnan(found[:, 0]).tolist() == [True, False, False, True, False, False, True]


def test_values_are_unwrapped_scaled_shifted_signed_and_converted_in_this_order():
    source = ChannelSource(fields=("x",), unit="deg", scale=2.0, offset=10.0, sign=-1, wrap=Wrap(above=100, period=256))
    raw = np.array([[45.0], [246.0]])  # the second is -10
    angle = convert("steer_angle", source, raw, SMALL.vehicle)[:, 0]
    np.testing.assert_allclose(angle, np.deg2rad([-100.0, 10.0]))


def test_a_steering_command_that_is_a_turn_rate_is_the_angle_of_a_bicycle_that_turns_so():
    vehicle = SMALL.vehicle
    source = ChannelSource(("turn", "speed"), unit="deg/s", scale=2.0, sign=-1)
    speed = np.array([2.0, 4.0, -2.0, 0.0, 0.0, 1.0])
    turn = np.array([0.3, -0.4, 0.3, 0.5, 0.0, np.nan])
    raw = np.column_stack((-np.rad2deg(turn) / 2, speed))
    steer = convert("steer", source, raw, vehicle)
    assert steer.shape == (6, 1)
    angle = vehicle.max_steer * steer[:, 0]
    np.testing.assert_allclose(speed[:3] * np.tan(angle[:3]) / vehicle.wheelbase, turn[:3], rtol=1e-12)
    assert angle[2] < 0, "backwards, the wheels point to the other side"
    np.testing.assert_allclose(angle[3:5], (1.48, 0.0), atol=0.01, err_msg="on the spot, and at a standstill")
    assert np.isnan(angle[5])
    read_back, notes = read(np.arange(6), raw, "steer", unit="deg/s", scale=2.0, sign=-1, clip=(-1.0, 1.0))
    np.testing.assert_allclose(read_back.values, np.clip(steer[:5], -1, 1))
    assert ["1 of 6 samples are not finite" in note for note in notes] == [True]


def test_the_size_of_a_commanded_speed_is_clipped_last():
    source = ChannelSource(("speed",), scale=0.5, clip=(0.0, 1.0), absolute=True)
    found, _ = read([0.0, 1.0, 2.0, 3.0], [-1.0, 0.5, -4.0, 1.0], scale=0.5, clip=(0.0, 1.0), absolute=True)
    np.testing.assert_array_equal(found.values[:, 0], [0.5, 0.25, 1.0, 0.5])
    np.testing.assert_array_equal(convert("throttle", source, np.array([[-1.0]]), SMALL.vehicle), [[0.5]])


def test_a_steering_command_that_is_an_angle_is_over_the_largest_one():
    source = ChannelSource(fields=("angle",), unit="deg")
    steer = convert("steer", source, np.array([[-10.0], [5.0]]), SMALL.vehicle)
    np.testing.assert_allclose(steer * SMALL.vehicle.max_steer, np.deg2rad([[-10.0], [5.0]]))


@pytest.mark.parametrize(
    ("recorded", "source", "gears"),
    [
        ([-1, 0, 1, 6, -2], {}, [-1, 0, 1, 1, -1]),
        ([1, 0, -1], {"sign": -1}, [-1, 0, 1]),
        ([0, 1, 2, 3, np.nan], {"values": {"0": 0.0, "1": -1.0, "2": 0.0, "3": 1.0}}, [0, -1, 0, 1]),
        ([0, 1], {"values": {"false": 1.0, "true": -1.0}}, [1, -1]),
        ([82, 68], {"values": {"R": -1.0, "D": 1.0}}, [-1, 1]),
    ],
)
def test_of_a_gears_number_the_sign_counts_and_values_stand_for_others(recorded, source, gears):
    found, _ = read(range(len(recorded)), recorded, "gear", **source)
    assert found.values[:, 0].tolist() == gears


@pytest.mark.parametrize(
    ("time", "values", "source", "kept", "said"),
    [
        ([1.0, 2.0], [0.0, 1.0], {"delay": 0.25}, [0.75, 1.75], ""),
        ([0, 1, 2, 3], [0.1, 9, 0.2, 0.3], {"valid": (0.0, 1.0)}, [0, 2, 3], "1 of 4 samples are not finite or not"),
        ([0, 1, 2, 3], [0.1, 500.0, 0.2, 1.1], {"valid": (-0.2, 1.2), "clip": (0.0, 1.0)}, [0, 2, 3], "1 of 4"),
        *(
            ([0, 1, 2, 3], [0.1, fault, 0.2, 0.3], {"clip": clip}, [0, 2, 3], "1 of 4 samples are not finite")
            for fault in (np.nan, -np.inf, 1e10)
            for clip in (None, (0.0, 1.0))
        ),
        ([0, np.nan, 2, np.inf, 4], [1, 2, 3, 4, 5], {}, [0, 2, 4], "2 of 5"),
        ([0, 1, 1, 2, 1.5, 3, 4, 5], np.arange(8), {}, [0, 1, 2, 3, 4, 5], "2 of 8 stamps repeat or go back"),
        (np.repeat(np.arange(10.0), 3), np.repeat(np.arange(10), 3), {}, range(10), "20 of 30 stamps repeat"),
        (range(3), [(9.9e6, 0), (9.9e6, 0), (2e7, 0)], {"name": "position"}, [0, 1], "1 of 3"),  # northings are kept
        (range(4), [(0, 0, 0, 1), (0, 0, 0, 0), (0, 0, 1, 0), (0, 0, 2, 0)], {"name": "orientation"}, [0, 2], "2 of 4"),
    ],
)
def test_faulty_samples_are_dropped_and_noted(time, values, source, kept, said):
    found, notes = read(time, values, **source)
    assert found.time.tolist() == list(kept)
    assert said in "".join(notes)
    assert bool(said) == bool(notes)


def test_rows_that_a_slower_sensor_leaves_empty_are_left_out_without_a_word():
    values = np.where(np.arange(100) % 2, np.nan, np.arange(100) / 100)
    found, notes = read(np.arange(100.0), values)
    assert found.time.tolist() == list(range(0, 100, 2))
    assert notes == []
    values[50] = np.inf
    _, notes = read(np.arange(100.0), values)
    assert "1 of 50 samples" in notes[0]


@pytest.mark.parametrize(
    ("time", "values", "source", "message"),
    [
        (np.zeros(10), range(10), {}, r"stamps repeat or go back.*clock"),
        ([0, 1], [np.nan, np.nan], {}, r"'throttle'.*'topic'.*no usable samples"),
        (range(4), 4 * [(48.0, 11.0, 0.0)], {"name": "position", "unit": "lat lon", "origin": (11.0, 48.0)},
         r"position\.origin lies \d+ km from the places of .*; .*in this order"),
        (range(3), [3, 4, 4], {"name": "gear", "values": {"3": 1.0}},
         r"gear.values lacks 4, which topic 'topic' has 2 times.*\"3\" = 1"),
    ],
)  # fmt: skip
def test_unusable_samples_are_an_error_that_names_the_channel(time, values, source, message):
    with pytest.raises(OffpisteError, match=message):
        read(time, values, **source)


def test_a_grid_of_time_is_no_longer_than_a_day():
    refuse_long(1e9, 1e9 + 86_400, "log")
    with pytest.raises(LogError, match=r"log: stamps span 25 hours; fix clock.unit"):
        refuse_long(1e9, 1e9 + 90_000, "log")
    with pytest.raises(LogError, match="stamps span 48 hours"):
        common_span([channel([0.0, 2 * 86_400], [0.0, 1.0])], "log")


def test_samples_out_of_order_are_sorted_where_the_rig_says_so():
    shuffled = [0.0, 0.3, 0.1, 0.2, 0.4], [0.0, 3.0, 1.0, 2.0, 4.0], "yaw_rate"
    assert len(read(*shuffled)[0].time) < 5
    ordered, notes = read(*shuffled, rig=small_rig("[clock]\nsort = true\n"))
    np.testing.assert_allclose(ordered.values[:, 0], 10 * ordered.time)
    assert len(ordered.time) == 5
    assert notes == []


def test_an_orientation_is_turned_about_the_bodys_z_axis():
    quaternion = Rotation.random(10, random_state=0).as_quat()
    source = ChannelSource(fields=("x", "y", "z", "w"), offset=0.7)
    turned = Rotation.from_quat(convert("orientation", source, quaternion, SMALL.vehicle)).as_matrix()
    expected = Rotation.from_quat(quaternion).as_matrix() @ Rotation.from_euler("z", 0.7).as_matrix()
    np.testing.assert_allclose(turned, expected, atol=1e-12)


def _rows_of(rate: float, seconds: float = 30.0, table: float = 100.0) -> np.ndarray:
    """Mark the rows of a table without a sample of a sensor of this rate [Hz]."""
    slot = np.floor(np.arange(0, seconds, 1 / table) * rate + 1e-9)
    return np.append(False, np.diff(slot) == 0)


@pytest.mark.parametrize("rate", [4.0, 10.0, 30.0, 37.0, 50.0, 66.0, 80.0])
def test_a_slower_sensor_leaves_rows_empty(rate: float) -> None:
    empty = _rows_of(rate)
    assert empty.mean() == pytest.approx(1 - rate / 100, abs=0.02)
    np.testing.assert_array_equal(between_samples(empty), empty)


@pytest.mark.parametrize("apart", [0.003, -0.003, 0.02])
def test_parts_in_rows_of_their_own_are_brought_together(apart: float) -> None:
    each = 0.05 * np.arange(100)
    time, parts = np.concatenate([each, each + apart]), np.full((200, 2), np.nan)
    parts[:100, 0], parts[100:, 1] = each, -each
    order = np.argsort(time)
    found = brought_together(time[order], parts[order])
    whole = np.isfinite(found).all(axis=1)
    if abs(apart) > 0.01:
        assert not whole.any()
        return
    np.testing.assert_array_equal(found[whole], np.column_stack([each, -each]))
    assert np.isnan(found[~whole]).all()
    np.testing.assert_array_equal(time[order][whole], each)


def test_rows_that_hold_all_parts_are_left_as_they_are() -> None:
    time, values = 0.005 * np.arange(100), np.random.default_rng(0).normal(size=(100, 2))
    values[::3, 0], values[1::3, 1] = np.nan, np.nan
    np.testing.assert_array_equal(brought_together(time, values), values)


def test_what_a_slower_sensor_loses_is_no_row_between_its_samples() -> None:
    empty, lost = _rows_of(20.0), np.zeros(3000, bool)
    lost[1001:1100] = True
    found = between_samples(empty | lost)
    assert not found[lost].any()
    np.testing.assert_array_equal(found[:990], empty[:990])


def test_rows_lost_at_random_and_one_run_or_few_are_lost() -> None:
    one = np.zeros(1000, bool)
    one[300:600] = True
    random = [np.random.default_rng(0).random(5000) < share for share in (0.05, 0.2, 0.5, 0.8)]
    for empty in (one, np.tile([False, True], 5), np.zeros(0, bool), *random):
        assert not between_samples(empty).any()


def test_of_a_clock_that_was_set_back_the_rows_before_are_kept():
    time = np.append(np.arange(60.0), np.arange(50.0, 100.0))
    assert np.flatnonzero(~increasing(time)).tolist() == list(range(60, 70))


@pytest.mark.parametrize("seed", range(20))
def test_as_many_rows_are_kept_as_can_be(seed):
    time = np.random.default_rng(seed).integers(0, 12, size=12).astype(float)
    kept = increasing(time)
    assert (np.diff(time[kept]) > 0).all()
    rows = range(len(time))
    most = max(n for n in rows if any((np.diff(time[list(some)]) > 0).all() for some in combinations(rows, n)))
    assert kept.sum() == most


HALF = np.diag([1.0, -1.0, -1.0])
SOURCE = {frame: ChannelSource(fields=("x", "y", "z"), frame=frame) for frame in ("", "world", "body")}


@pytest.mark.parametrize(("axes", "world", "body"), [("body down", 0, 1), ("world down", 1, 0), ("ned", 1, 1)])
def test_orientations_and_vectors_turn_as_their_matrices_do(axes: str, world: int, body: int) -> None:
    generator = np.random.default_rng(0)
    quaternion = Rotation.random(20, random_state=1).as_quat()
    left, right = (HALF if turn else np.eye(3) for turn in (world, body))
    turned = Rotation.from_quat(to_z_up("orientation", SOURCE[""], quaternion, axes)).as_matrix()
    np.testing.assert_allclose(turned, left @ Rotation.from_quat(quaternion).as_matrix() @ right, atol=1e-12)
    vectors = generator.standard_normal((20, 3))
    for name, frame, matrix in (
        ("position", "", left),
        ("linear_velocity", "world", left),
        ("linear_velocity", "body", right),
        ("angular_velocity", "body", right),
    ):
        np.testing.assert_allclose(to_z_up(name, SOURCE[frame], vectors, axes), vectors @ matrix.T, atol=1e-12)


def test_an_offset_turns_to_the_left_by_its_sign() -> None:
    yaw = np.array([[0.2]])
    assert to_z_up("yaw", SOURCE[""], yaw, "ned") == -yaw
    assert to_z_up("yaw", SOURCE[""], yaw, "body down") == yaw
    for axes in ("z up", "body down", "world down", "ned"):
        turned = to_z_up("yaw", SOURCE[""], yaw + 0.1, axes) - to_z_up("yaw", SOURCE[""], yaw, axes)
        assert turned == pytest.approx(0.1 * turning_sign("yaw", axes))
        before, after = (Rotation.from_euler("z", angle).as_quat()[None] for angle in (0.2, 0.3))
        before, after = (to_z_up("orientation", SOURCE[""], each, axes) for each in (before, after))
        about_body = (Rotation.from_quat(before).inv() * Rotation.from_quat(after)).as_rotvec()[0, 2]
        assert about_body == pytest.approx(0.1 * turning_sign("orientation", axes))


def test_latitude_and_longitude_have_no_axes_and_are_laid_into_the_world_of_the_others() -> None:
    """In a log with a north, east, down world, other channels become north, west, up; the height is up already."""
    east_north_up = np.array([[1.0, 2.0, 3.0], [-4.0, 5.0, -6.0]])
    north_west_up = np.array([[2.0, -1.0, 3.0], [5.0, 4.0, -6.0]])
    source = ChannelSource(fields=("lat", "lon", "height"), unit="lat lon")
    for axes in ("z up", "body down", "world down", "ned"):
        expected = north_west_up if axes in ("world down", "ned") else east_north_up
        assert (to_z_up("position", source, east_north_up, axes) == expected).all()
        assert (to_z_up("position", source, east_north_up[:, :2], axes) == expected[:, :2]).all()
