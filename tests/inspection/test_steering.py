"""Steering: its scale where no rig knows the wheelbase."""

import numpy as np
import pytest
from simulated import MAX_STEER, START, MemoryLog, drive_log, rig

from offpiste.inspection.driven_path import DrivenPath, driven_path
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.lags import LagFit
from offpiste.inspection.steering import check_steering
from offpiste.inspection.steering_fit import SteeringFit, steering_fit, steering_fits
from offpiste.logs.channel import Channel
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited

WHEELBASE = 0.18
TRUE = np.tan(MAX_STEER) / WHEELBASE


@pytest.mark.parametrize("most", [100.0, 4.0])
def test_the_scale_of_a_first_rig_is_that_of_tyres_that_grip(most: float) -> None:
    """Fast curves slide outwards; what the vehicle turns in them says nothing on its steering."""
    (finding,) = (f for f in inspect_log(_curves(most)).findings if (f.where, f.what) == ("steer", "has this scale"))
    assert float(finding.evidence.split()[5]) == pytest.approx(TRUE, rel=0.12)


def _curves(most: float) -> MemoryLog:
    """Curves of a small car at 0.5 to 3.5 m/s.

    Args:
        most: largest lateral acceleration, at which tyres slide [m/s^2].
    """
    random = np.random.default_rng(1)
    time = np.arange(0, 120, 0.02)
    v = 2 + 1.5 * np.sin(time / 7)
    steer = 0.8 * np.sin(time / 1.7) * np.sin(time / 11)
    yaw_rate = v * np.tan(MAX_STEER * steer) / WHEELBASE
    yaw_rate = most / v * np.tanh(yaw_rate * v / most)
    yaw = np.cumsum(yaw_rate) * 0.02
    zero = np.zeros(len(time))
    odom = {"x": np.cumsum(v * np.cos(yaw)) * 0.02, "y": np.cumsum(v * np.sin(yaw)) * 0.02, "z": zero}
    odom |= {"qx": zero, "qy": zero, "qz": np.sin(yaw / 2), "qw": np.cos(yaw / 2)}
    odom = {field: column + 1e-3 * random.standard_normal(len(time)) for field, column in odom.items()}
    throttle = np.clip(0.5 + np.gradient(v, time) + 0.1 * v, 0, 1)
    pedals = {"throttle": throttle, "brake": np.where(time % 30 > 29, 0.1, 0.0)}
    return MemoryLog(
        {
            "odom": (START + time, odom),
            "pedals": (START + time, pedals),
            "steering": (START + time, {"command": steer}),
        }
    )


@pytest.mark.parametrize("off", [0.12, -0.2])
def test_a_steering_that_is_not_zero_straight_ahead_gets_its_offset(off: float) -> None:
    log = drive_log(seed=0).change("steering", "command", lambda values: values + off)
    (finding,) = (f for f in inspect_log(log, rig()).findings if f.what == "is not zero straight ahead")
    assert finding.where == "steer"
    assert float(finding.cures[0][0].value) == pytest.approx(-off, abs=0.02)


def test_small_trims_are_healthy() -> None:
    log = drive_log(seed=0).change("steering", "command", lambda values: values + 0.03)
    assert [f for f in inspect_log(log, rig()).findings if f.what == "is not zero straight ahead"] == []


def test_places_in_feet_are_likelier_than_wheels_that_hardly_turn() -> None:
    log = drive_log(seed=0)
    for axis in "xyz":
        log = log.change("odom", axis, lambda values: 3.28084 * values)
    drive = drive_from_log(log, rig())
    path = driven_path(drive)
    found = check_steering(steering_fits(drive, path, measured=True), drive, path, measured=True)
    (finding,) = (f for f in found if f.where == "steer" and f.what == "turns the vehicle less than the rig says")
    first, *others = (str(edit) for cure in finding.cures for edit in cure)
    assert first == 'channels.position.unit = "ft"'
    assert any(other.startswith("vehicle.max_steer") for other in others)


def test_places_of_no_unit_are_scaled_where_command_and_wheels_agree() -> None:
    log = drive_log(seed=0)
    for axis in "xyz":
        log = log.change("odom", axis, lambda values: 2 * values)
    posed = edited(rig(), [Edit("channels.linear_velocity", None)])
    (finding,) = (f for f in inspect_log(log, posed).findings if f.severity == "warning")
    (edit,) = finding.cures[0]
    assert edit.key == "channels.position.scale"
    assert edit.value == pytest.approx(0.5, rel=0.1)


def test_a_range_of_steering_and_places_that_are_both_wrong_are_both_cured() -> None:
    log = drive_log(seed=0)
    for axis in "xyz":
        log = log.change("odom", axis, lambda values: 3.28084 * values)
    wrong = rig((f"max_steer = {MAX_STEER}", f"max_steer = {2 * MAX_STEER}"))
    found = inspect_log(log, edited(wrong, [Edit("channels.linear_velocity", None)])).findings
    cures = {edit.key: edit.value for f in found if f.severity != "note" for edit in f.cures[0]}
    assert cures == {"channels.position.unit": "ft", "vehicle.max_steer": pytest.approx(MAX_STEER, rel=0.05)}


def test_a_command_of_another_unit_is_likelier_than_wheels_that_turn_further_than_any() -> None:
    """A servo from 0 to 1, 0.53 straight ahead, whose rig has no scale yet."""
    servo = drive_log(seed=0).change("steering", "command", lambda values: 0.53 + 0.2 * values)
    without = [Edit("channels.steer_angle", None), Edit("absent", [*rig().absent, "steer_angle"])]
    first = edited(rig(), [Edit("channels.steer.offset", -0.53), *without])
    (finding,) = (f for f in inspect_log(servo, first).findings if f.severity == "warning")
    scale, offset = finding.cures[0]
    assert (scale.key, offset.key) == ("channels.steer.scale", "channels.steer.offset")
    assert scale.value == pytest.approx(5, rel=0.15)
    assert offset.value / scale.value == pytest.approx(-0.53, rel=1e-3)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_wheels_in_another_place_are_likelier_than_places_of_no_unit(factor: float) -> None:
    places = [[factor * x, y] for x, y in rig().vehicle.wheel_positions]
    wrong = edited(rig(), [Edit("vehicle.wheel_positions", places), Edit("channels.linear_velocity", None)])
    (finding,) = (f for f in inspect_log(drive_log(seed=0), wrong).findings if f.severity == "warning")
    assert [edit.key for edit in finding.cures[0]] == ["vehicle.wheel_positions"]


def test_places_are_not_scaled_where_the_wheels_go_as_far() -> None:
    wrong = rig((f"max_steer = {MAX_STEER}", f"max_steer = {MAX_STEER * 0.2:.3f}"))
    findings = inspect_log(drive_log(seed=0), wrong).findings
    assert not any(edit.key == "channels.position.scale" for f in findings for cure in f.cures for edit in cure)


@pytest.mark.parametrize("understeer", [0.0, 0.005, 0.02])
def test_slip_that_grows_with_the_speed_is_taken_out_of_the_scale(understeer: float) -> None:
    """At no speed, a bicycle turns as its geometry says, whatever its understeer."""
    time = np.arange(0, 120, 0.05)
    speed = 6 + 4 * np.sin(time / 9)
    steer = 0.6 * np.sin(time / 1.9) * np.sin(time / 7)
    yaw_rate = speed * np.tan(MAX_STEER) * steer / (2.5 * (1 + understeer * speed**2))
    yaw = np.cumsum(yaw_rate) * 0.05
    velocity = speed[:, None] * np.stack((np.cos(yaw), np.sin(yaw)), axis=1)
    still = np.zeros(len(time))
    path = DrivenPath(time, np.cumsum(velocity, axis=0) * 0.05, velocity, speed, speed, yaw, yaw_rate, still, still)
    fit = steering_fit(Channel("steer", "", time, steer[:, None]), path, rig(), measured=True)
    assert fit is not None
    assert fit.extrapolated is not None
    assert 1 / fit.extrapolated.gain[0] == pytest.approx(np.tan(MAX_STEER) / 2.5, rel=0.03)


@pytest.mark.parametrize("factor", [0.5, 0.67, 1.5, 2.0])
def test_a_range_of_steering_that_is_wrong_by_a_half_is_found(factor: float) -> None:
    wrong = rig((f"max_steer = {MAX_STEER}", f"max_steer = {MAX_STEER * factor:.3f}"))
    (finding,) = (f for f in inspect_log(drive_log(seed=0), wrong).findings if f.severity == "warning")
    assert finding.where == "steer"
    assert finding.cures[0][0].key == "vehicle.max_steer"
    assert finding.cures[0][0].value == pytest.approx(MAX_STEER, rel=0.1)


def test_a_range_that_no_vehicle_has_speaks_for_another_wheelbase() -> None:
    """Without a measured angle, wheels four times too far apart would ask for wheels that turn by 1.2 rad."""
    far = rig()
    places = [[4 * x, y] for x, y in far.vehicle.wheel_positions]
    far = edited(far, [Edit("vehicle.wheel_positions", places)])
    drive = drive_from_log(drive_log(seed=0), far)
    del drive.channels["steer_angle"]
    path = driven_path(drive)
    (finding,) = check_steering(steering_fits(drive, path, measured=True), drive, path, measured=True)
    assert finding.what == "turns the vehicle more than the rig says"
    assert [cure[0].key for cure in finding.cures] == [
        "vehicle.wheel_positions",
        "channels.steer.scale",
    ]
    found = np.ptp([x for x, _ in finding.cures[0][0].value])
    assert found == pytest.approx(np.ptp([x for x, _ in rig().vehicle.wheel_positions]), rel=0.1)


def test_a_rig_of_no_vehicles_shape_has_the_wrong_wheelbase() -> None:
    """2.5 m of wheelbase on 1.2 m of track; with 5 m, the wheels would still turn as far as some vehicle's."""
    long = edited(rig(), [Edit("vehicle.wheel_positions", [[2 * x, y] for x, y in rig().vehicle.wheel_positions])])
    drive = drive_from_log(drive_log(seed=0), long)
    del drive.channels["steer_angle"]
    path = driven_path(drive)
    (finding,) = check_steering(steering_fits(drive, path, measured=True), drive, path, measured=True)
    assert [cure[0].key for cure in finding.cures][:2] == ["vehicle.wheel_positions", "vehicle.max_steer"]


def test_a_command_that_is_the_angle_of_the_wheels_is_read_as_one() -> None:
    without = edited(rig(), [Edit("channels.steer_angle", None), Edit("absent", [*rig().absent, "steer_angle"])])
    log = drive_log(seed=0).change("steering", "command", lambda steer: MAX_STEER * steer)
    (finding,) = (f for f in inspect_log(log, without).findings if f.severity == "warning")
    assert finding.cures[0] == (Edit("channels.steer.unit", "rad"),)
    # An angle whose zero is elsewhere: the rig knows where, and it stays there.
    moved = log.change("steering", "command", lambda angle: angle + 0.05)
    given = edited(without, [Edit("channels.steer.offset", -0.05)])
    (finding,) = (f for f in inspect_log(moved, given).findings if f.severity == "warning")
    assert finding.cures[0] == (Edit("channels.steer.unit", "rad"),)


@pytest.mark.parametrize(("steady", "sign"), [(0.98, 1), (0.6, -1)])
def test_who_goes_where_he_steers_does_not_drift(steady: float, sign: int) -> None:
    """What the steering changes about the turning decides about a drift, in which drivers countersteer."""
    lags = np.arange(-0.1, 0.11, 0.05)

    def fit(r: float) -> LagFit:
        ones = np.ones((10, len(lags)))
        return LagFit(lags, r * ones[0], r * ones[0], 1000, r * ones, r * ones)

    turned = fit(-0.31)
    assert SteeringFit(fit(steady), turned, fit(steady), fit(steady), None, 0.0, np.inf).sign == sign


@pytest.mark.parametrize("topics", [["steering"], ["pedals", "steering"]])
def test_a_clock_that_is_seconds_apart_is_found_by_where_it_begins_and_ends(topics: list[str]) -> None:
    log = drive_log(seed=0)
    for topic in topics:
        log = log.restamp(topic, lambda time: time + 18.0)
    cure = {edit.key: edit.value for edit in inspect_log(log, rig()).cure}
    # Of two that are alike, the pose is what is apart.
    moved = (
        ["steer", "steer_angle"] if len(topics) == 1 else [n for n, s in rig().channels.items() if s.topic == "odom"]
    )
    assert cure == {
        f"channels.{name}.delay": pytest.approx(18.0 if len(topics) == 1 else -18.0, abs=0.1) for name in moved
    }


def test_a_steering_that_begins_late_and_ends_in_time_has_the_right_clock() -> None:
    log = drive_log(seed=0)
    late = log.keep("steering", np.flatnonzero(log.data["steering"][0] > START + 18.0))
    late = late.change("steering", "command", lambda values: np.random.default_rng(0).permutation(values))
    assert not [edit for edit in inspect_log(late, rig()).cure if edit.key.endswith("delay")]
