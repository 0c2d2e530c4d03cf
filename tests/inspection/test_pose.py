"""Poses and velocities: impossible samples, noise, units, axes, rates."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig, severe

from offpiste.core.errors import LogError
from offpiste.dataset.resample import extract_rows
from offpiste.inspection.findings import Finding
from offpiste.inspection.inspect import Inspection, inspect_log
from offpiste.inspection.pose_samples import check_level
from offpiste.logs.channel import Channel
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig

CLEAN = drive_log(seconds=60)
PLACE_ONLY = edited(rig(), [Edit("channels.linear_velocity", None), Edit("channels.angular_velocity", None)])

LATITUDES = edited(
    rig(), [Edit("channels.position.unit", "lat lon"), Edit("channels.position.fields", ["y", "x", "z"])]
)


def _inspected(log: MemoryLog, now: Rig | None = None) -> tuple[Inspection, list[Finding]]:
    found = inspect_log(log, now or rig())
    return found, [f for f in found.findings if f.severity != "note"]


def test_a_corrupt_run_is_named_by_its_samples_and_spoils_no_summary() -> None:
    def corrupt(x: np.ndarray) -> np.ndarray:
        x[1000:1086] = 1e10 * np.random.default_rng(0).uniform(0.9, 1.1, 86)
        return x

    found, complaints = _inspected(CLEAN.change("odom", "x", corrupt))
    assert any("first 1000, the last 1085" in f.evidence for f in complaints if f.where.startswith("position"))
    assert found.summary.speed_max < 20


def test_a_heading_that_jumps_is_reported_and_accuses_nothing_else() -> None:
    def jump(log: MemoryLog) -> MemoryLog:
        _, odom = log.data["odom"]
        yaw = 2 * np.arctan2(odom["qz"], odom["qw"])
        yaw[1500:1502] += 0.5
        return log.put("odom", qz=np.sin(yaw / 2), qw=np.cos(yaw / 2))

    _, complaints = _inspected(jump(CLEAN))
    assert {f.where for f in complaints} == {"orientation"}


@pytest.mark.parametrize("now", [rig(), PLACE_ONLY], ids=["with velocities", "places only"])
def test_noise_that_spoils_starts_or_velocities_is_reported(now: Rig) -> None:
    random = np.random.default_rng(0)
    log = CLEAN.change("odom", "x", lambda x: x + 0.5 * random.standard_normal(len(x)))
    log = log.change("odom", "y", lambda y: y + 0.5 * random.standard_normal(len(y)))
    _, complaints = _inspected(log, now)
    assert any(f.where == "position" and "nois" in f.what for f in complaints), complaints
    assert _inspected(CLEAN, now)[1] == []


@pytest.mark.parametrize("speed", [30.0])
def test_positions_that_run_away_change_their_velocity_in_an_instant(speed: float) -> None:
    def run_away(x: np.ndarray) -> np.ndarray:
        x[2400:] += speed * 0.02 * np.arange(len(x) - 2400)
        return x

    _, complaints = _inspected(CLEAN.change("odom", "x", run_away))
    (finding,) = (f for f in complaints if f.what == "changes velocity abruptly")
    assert float(finding.evidence.split()[1]) == pytest.approx(48.0, abs=0.6)
    assert {f.what for f in complaints if f.severity != "note"} == {finding.what}  # what follows from it is not said


@pytest.mark.parametrize("longitude", [8.5, 208.8])
def test_degrees_reach_around_the_earth_and_heights_are_metres(longitude: float) -> None:
    """A degree is some 111 km, so what is far for one is near for the other."""
    log = CLEAN.change("odom", "x", lambda east: east / 84_880 + longitude)
    log = log.change("odom", "y", lambda north: north / 111_040 + 47.4).change("odom", "z", lambda up: up + 2450)
    assert [f for f in inspect_log(log, LATITUDES).findings if "beyond" in f.what] == []
    nowhere = log.change("odom", "y", lambda north: np.where(np.arange(len(north)) == 700, 95.0, north))
    (finding,) = (f for f in inspect_log(nowhere, LATITUDES).findings if "beyond" in f.what)
    assert finding.where == "position (odom y)"
    assert finding.evidence.startswith("1 of ")


def test_degrees_that_are_counted_get_their_scale_and_lose_a_height_in_another() -> None:
    """As PX4 and u-blox receivers record them: integers of 1e-7 degrees, and millimetres of height."""
    log = CLEAN.change("odom", "x", lambda east: np.round(1e7 * (east / 75_488 + 8.5)))
    log = log.change("odom", "y", lambda north: np.round(1e7 * (north / 111_180 + 47.4)))
    log = log.change("odom", "z", lambda up: np.round(1000 * (up + 450)))
    found = inspect_log(log, LATITUDES)
    fatal = [f for f in found.findings if f.severity == "fatal"]
    assert {f.what for f in fatal} == {"is counted in ten-millionths of a degree"}
    assert found.cure == (Edit("channels.position.scale", 1e-7), Edit("channels.position.fields", ["y", "x"]))
    cured = edited(LATITUDES, found.cure)
    assert not severe(log, cured)
    driven = np.hypot(*np.ptp(drive_from_log(CLEAN, rig()).channels["position"].values[:, :2], axis=0))
    assert np.hypot(*np.ptp(drive_from_log(log, cured).channels["position"].values, axis=0)) == pytest.approx(
        driven, 0.01
    )


@pytest.mark.parametrize("heading", [False, True])
def test_a_place_that_hangs_while_the_vehicle_drives_on_is_found(heading: bool) -> None:
    log = drive_log(seed=3)
    time, odom = log.data["odom"]
    speed = np.hypot(np.gradient(odom["x"], time), np.gradient(odom["y"], time))
    first = int(np.argmax((speed > 3.0) & (time > time[0] + 20.0)))
    end = int(np.searchsorted(time, time[first] + 8.0))
    for field in ("x", "y", "z", *(("qx", "qy", "qz", "qw") if heading else ())):
        log = log.change("odom", field, lambda values: np.concatenate(
            (values[:first], np.full(end - first, values[first]), values[end:])))  # fmt: skip
    found = {(finding.where, finding.what): finding for finding in inspect_log(log, rig()).findings}
    finding = found["position", "stays at one place while the vehicle drives on"]
    assert f"for 8.0 s from {time[first + 1] - time[0]:.2f} s on" in finding.evidence
    assert ("position", "jumps") not in found


def _span(x: float, y: float, z: float, seed: int = 0) -> list[Finding]:
    """What a loop of these sizes along the axes, which scatters by some centimetres, says of the axis that is up."""
    angle, rng = np.linspace(0, 6 * np.pi, 3000), np.random.default_rng(seed)
    place = np.stack((x * np.cos(angle), y * np.sin(0.3 * angle), z * np.sin(angle)), axis=1) / 2
    place += rng.normal(0, 0.05, place.shape)
    given = rig(('fields = ["x", "y", "z"]', 'fields = ["px", "py", "pz"]'))
    return check_level(Channel("position", "m", np.arange(3000) / 50, place), given, ())


@pytest.mark.parametrize(("x", "y", "z"), [(400.0, 3.0, 180.0), (180.0, 3.0, 400.0), (50.0, 0.0, 50.0)])
def test_y_is_up_where_the_path_is_level_only_along_it(x: float, y: float, z: float) -> None:
    """Also where it goes further along x than along z."""
    (finding,) = _span(x, y, z)
    assert finding.severity == "fatal"
    ways = [{edit.key: edit.value for edit in cure}["channels.position.fields"] for cure in finding.cures]
    assert [sorted(way) for way in ways] == 2 * [["px", "py", "pz"]]
    assert all(way[2] == "py" for way in ways)


TIME, ODOM = CLEAN.data["odom"]
EVERY = round(0.1 / float(np.median(np.diff(TIME))))
"""Samples in a tenth of a second."""


def _posed(time: np.ndarray, rows: np.ndarray) -> MemoryLog:
    return MemoryLog(CLEAN.data | {"odom": (time, {name: values[rows] for name, values in ODOM.items()})})


def test_places_that_come_too_seldom_to_differentiate_get_a_wider_window() -> None:
    rows = np.arange(0, len(TIME), EVERY)
    log = _posed(TIME[rows], rows)
    (finding,) = (f for f in inspect_log(log, PLACE_ONLY).findings if f.severity == "fatal")
    assert finding.what == "is sampled too rarely to differentiate"
    assert extract_rows(drive_from_log(log, edited(PLACE_ONLY, finding.cures[0]))).valid.mean() > 0.9
    with pytest.raises(LogError, match="of 'state"):
        extract_rows(drive_from_log(log, PLACE_ONLY))


def test_rows_that_hold_the_last_value_are_left_out_by_the_cure() -> None:
    log = _posed(TIME, np.arange(len(TIME)) // EVERY * EVERY)
    (finding,) = (f for f in inspect_log(log, PLACE_ONLY).findings if f.severity == "warning")
    assert finding.what == "repeats its last value"
    cured = edited(PLACE_ONLY, finding.cures[0])
    assert cured.channels["position"].repeats == cured.channels["orientation"].repeats == "drop"
    assert severe(log, cured) == []
    true, held, left = (_speed(*each) for each in ((CLEAN, rig()), (log, PLACE_ONLY), (log, cured)))
    assert np.nanstd(left - true) < 0.6 * np.nanstd(held - true)


def _speed(log: MemoryLog, now: Rig) -> np.ndarray:
    """Forward speed as known at the time, every 20 ms of the log's middle."""
    rows = extract_rows(drive_from_log(log, now))
    return np.interp(np.arange(TIME[0] + 5, TIME[-1] - 5, 0.02), rows.time, rows.state_causal[:, 3])


DRIVE = drive_log()


def _sliding(sign: float) -> MemoryLog:
    """The vehicle slides outwards in its curves: it goes to the right of its heading in left ones."""
    _, odom = DRIVE.data["odom"]
    slip = -0.02 * odom["vx"] * odom["wz"]
    yaw = 2 * np.arctan2(odom["qz"], odom["qw"]) - slip
    columns = {
        "qz": np.sin(yaw / 2),
        "qw": np.cos(yaw / 2),
        "wz": np.gradient(yaw, 0.02),
        "vx": odom["vx"] * np.cos(slip),
        "vy": sign * odom["vx"] * np.sin(slip),
    }
    return DRIVE.put("odom", **columns)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_velocity_to_the_side_that_is_positive_to_the_right_is_found(sign: float) -> None:
    log = _sliding(sign)
    found = [f for f in inspect_log(log, rig()).findings if f.where == "linear_velocity"]
    assert [(f.severity, f.what) for f in found] == [("warning", "is positive to the right")] * (sign < 0)
    for finding in found:
        # Poses whose z points up are not turned for it: the velocity alone is wrong.
        assert finding.cures[0] == (Edit("channels.linear_velocity.frame", "unknown"),)
        cured = inspect_log(log, edited(rig(), finding.cures[0]))
        assert not [f for f in cured.findings if f.where == "linear_velocity" and f.severity != "note"]


@pytest.mark.parametrize("frame", ["world", "body"])
def test_a_velocity_of_north_east_down_is_read_in_their_order(frame: str) -> None:
    time, odom = DRIVE.data["odom"]
    yaw = 2 * np.arctan2(odom["qz"], odom["qw"])
    north_east_down = {"vx": odom["vx"] * np.sin(yaw), "vy": odom["vx"] * np.cos(yaw), "vz": -odom["vz"]}
    log = MemoryLog({**DRIVE.data, "odom": (time, odom | north_east_down)})
    read = edited(rig(), [Edit("channels.linear_velocity.frame", frame)])
    (found,) = [f for f in inspect_log(log, read).findings if f.where == "linear_velocity"]
    assert found.what == "is in north, east, down but read as east, north, up"
    cured = edited(read, found.cures[0])
    assert (cured.channels["linear_velocity"].fields, cured.channels["linear_velocity"].frame) == (
        ("vy", "vx"),
        "world",
    )
    assert not [f for f in inspect_log(log, cured).findings if f.where == "linear_velocity"]
