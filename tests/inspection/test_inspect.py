"""Fault injection into a simulated drive: each fault is named alone, and its remedy silences it."""

from collections.abc import Callable

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig, severe

from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.findings import Finding
from offpiste.inspection.inspect import inspect_log
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import parse_rig

CLEAN = drive_log(seconds=60)
Fault = Callable[[MemoryLog], MemoryLog]


def complaints(log: MemoryLog, *changes: tuple[str, str]) -> list[Finding]:
    return [f for f in inspect_log(log, rig(*changes)).findings if f.severity != "note"]


def the_only(findings: list[Finding], where: str) -> Finding:
    assert [f for f in findings if f.where.startswith(where)], findings
    assert len(findings) == 1, findings
    return findings[0]


@pytest.mark.parametrize("seed", range(2))
def test_a_clean_log_raises_nothing_and_is_usable(seed: int) -> None:
    log = drive_log(seed=seed)
    for found in (inspect_log(log, rig()), inspect_log(log)):
        assert found.usable
        assert [f for f in found.findings if f.severity != "note"] == []


STEER = 'topic = "steering"\nfields = ["command"]'
ANGLE = 'topic = "steering"\nfields = ["angle"]'
THROTTLE = 'topic = "pedals"\nfields = ["throttle"]'
BRAKE = 'topic = "pedals"\nfields = ["brake"]'
VELOCITY = 'fields = ["vx", "vy", "vz"]\nframe = "body"'
RATES = 'fields = ["wx", "wy", "wz"]'
QUATERNION = 'fields = ["qx", "qy", "qz", "qw"]'
PLACE = 'fields = ["x", "y", "z"]'


def _world(log: MemoryLog) -> MemoryLog:
    _, odom = log.data["odom"]
    yaw = 2 * np.arctan2(odom["qz"], odom["qw"])
    vx, vy = odom["vx"], odom["vy"]
    return log.change("odom", "vx", lambda _: np.cos(yaw) * vx - np.sin(yaw) * vy).change(
        "odom", "vy", lambda _: np.sin(yaw) * vx + np.cos(yaw) * vy
    )


def _wxyz(log: MemoryLog) -> MemoryLog:
    _, odom = log.data["odom"]
    stored = {"qx": odom["qw"], "qy": odom["qx"], "qz": odom["qy"], "qw": odom["qz"]}
    log = log.put("odom", **stored)
    return log


def _wrapped(values: np.ndarray) -> np.ndarray:
    """A count in tenths that dips below zero, on the pedal's idle."""
    tenths = np.round(values * 300 - 20, 1)
    return np.where(tenths < 0, tenths + 6553.6, tenths)


def _with_spikes(values: np.ndarray) -> np.ndarray:
    values[[700, 1500, 2222]] = (40.0, -33.0, 25.0)
    return values


def changed(topic: str, fields: str, how: Callable[[np.ndarray], np.ndarray]) -> Fault:
    return lambda log: log.change(topic, fields, how)


FAULTS: dict[str, tuple[Fault, str, str, tuple[str, str], str]] = {
    "flipped steering": (changed("steering", "command", np.negative), "steer", "channels.steer.sign = -1",
                         (STEER, STEER + "\nsign = -1"), ""),
    "steering 0.3 s late": (lambda log: log.restamp("steering", lambda t: t + 0.3), "steer",
                            "channels.steer.delay = 0.4", (STEER, STEER + "\ndelay = 0.3"), "steer_angle"),
    "degrees": (changed("steering", "angle", np.degrees), "steer_angle", 'channels.steer_angle.unit = "deg"',
                (ANGLE, ANGLE + '\nunit = "deg"'), ""),
    "percent": (changed("pedals", "throttle", lambda x: 100 * x), "throttle", 'channels.throttle.unit = "percent"',
                (THROTTLE, THROTTLE + '\nunit = "percent"'), ""),
    "pedal the wrong way round": (changed("pedals", "throttle", lambda x: 1 - x), "throttle",
                                  "channels.throttle.scale = -1.0, channels.throttle.offset = 1.0",
                                  (THROTTLE, THROTTLE + "\nscale = -1.0\noffset = 1.0"), ""),
    "pedals 1 s late": (lambda log: log.restamp("pedals", lambda t: t + 1.0), "throttle",
                        "channels.throttle.delay = 1.", (THROTTLE, THROTTLE + "\ndelay = 1.0"), "brake"),
    "velocity in the world": (_world, "linear_velocity", 'channels.linear_velocity.frame = "world"',
                              ("frame", "frame"), ""),
    "km/h": (changed("odom", "vx vy", lambda v: 3.6 * v), "linear_velocity",
             'channels.linear_velocity.unit = "km/h"', (VELOCITY, VELOCITY + '\nunit = "km/h"'), ""),
    "velocity 0.4 s late": (changed("odom", "vx vy", lambda v: np.roll(v, 20)), "linear_velocity",
                            "channels.linear_velocity.delay = 0.4", (VELOCITY, VELOCITY + "\ndelay = 0.4"), ""),
    "deg/s": (changed("odom", "wz", np.degrees), "angular_velocity", 'channels.angular_velocity.unit = "deg/s"',
              (RATES, RATES + '\nunit = "deg/s"'), ""),
    "clockwise rates": (changed("odom", "wz", np.negative), "angular_velocity",
                        "channels.angular_velocity.sign = -1", (RATES, RATES + "\nsign = -1"), ""),
    "wxyz": (_wxyz, "orientation", 'channels.orientation.fields = ["qy", "qz", "qw", "qx"]',
             (QUATERNION, 'fields = ["qy", "qz", "qw", "qx"]'), ""),
    "millimetres": (changed("odom", "x y", lambda x: 1e3 * x), "position", 'channels.position.unit = "mm"',
                    (PLACE, 'fields = ["x", "y"]\nunit = "mm"'), ""),
    "wrapped counter": (changed("pedals", "throttle", _wrapped), "throttle", "channels.throttle.wrap = { above =",
                        (THROTTLE, THROTTLE + "\nwrap = { above = 3400.0, period = 6553.6 }\nscale = 0.003333"
                         "\nclip = [0.0, 1.0]"), "throttle"),
    "spikes": (changed("pedals", "throttle", _with_spikes), "throttle", "channels.throttle.valid = [",
               (THROTTLE, THROTTLE + "\nvalid = [0.0, 1.5]"), ""),
    "dead channel": (changed("steering", "angle", np.zeros_like), "steer_angle",
                     "remove channels.steer_angle, absent = [", (f"[channels.steer_angle]\n{ANGLE}", ""), ""),
}  # fmt: skip


@pytest.mark.parametrize(("fault", "where", "remedy", "change", "also"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_named_with_the_line_that_fixes_it(
    fault: Fault, where: str, remedy: str, change: tuple[str, str], also: str
) -> None:
    log = fault(CLEAN)
    found = complaints(log)
    blamed = {f.where.split(" ")[0] for f in found}
    assert blamed <= {where, also} - {""}, found
    assert any(f.where.split(" ")[0] in (where, also) and remedy in f.remedy for f in found), found
    assert all(any(c.isdigit() for c in f.evidence) for f in found)

    changes = [change]
    if "absent" in remedy:
        changes.append(('absent = ["brake_pressure"', f'absent = ["{where}", "brake_pressure"'))
    if 'frame = "world"' in remedy:
        changes = [(VELOCITY, VELOCITY.replace("body", "world"))]
    if where == "steer" and also:
        changes.append((ANGLE, ANGLE + "\ndelay = 0.3"))
    if also == "brake":
        changes.append((BRAKE, BRAKE + "\ndelay = 1.0"))
    left = complaints(log, *changes)
    assert left == [], left


@pytest.mark.parametrize(
    ("change", "where", "remedy"),
    [
        ((STEER, STEER + "\nsign = -1"), "steer", "channels.steer.sign = 1"),
        ((STEER, STEER + "\ndelay = -0.5"), "steer", "channels.steer.delay = 0.0"),
        ((VELOCITY, VELOCITY.replace("body", "world")), "linear_velocity", 'channels.linear_velocity.frame = "body"'),
        (("max_steer = 0.4", "max_steer = 0.1"), "steer", "vehicle.max_steer = 0.4"),
        ((ANGLE, ANGLE + '\nunit = "deg"'), "steer_angle", 'channels.steer_angle.unit = "rad"'),
    ],
)
def test_a_wrong_rig_gets_the_right_line(change: tuple[str, str], where: str, remedy: str) -> None:
    finding = the_only(complaints(CLEAN, change), where)
    value = finding.remedy.split(";")[0]
    key, _, number = value.partition(" = ")
    wanted_key, _, wanted = remedy.partition(" = ")
    assert key == wanted_key
    if wanted[0] in '"':
        assert number == wanted
    else:
        assert float(number) == pytest.approx(float(wanted), abs=0.15)  # a remedy leaves the delay of usual actuators


def test_steering_read_from_a_field_without_effect() -> None:
    random = np.random.default_rng(3)
    log = CLEAN.change("steering", "command", lambda x: random.uniform(-1, 1, len(x)))
    assert the_only(complaints(log), "steer").what == "does not turn the vehicle"


def test_a_pose_jump_says_when_and_how_far() -> None:
    def jump(x: np.ndarray) -> np.ndarray:
        x[2500:] += 4.0
        return x

    finding = the_only(complaints(CLEAN.change("odom", "x", jump)), "position")
    assert finding.what == "jumps"
    assert "at 50.00 s" in finding.evidence or "at 49.98 s" in finding.evidence


def test_a_drifting_clock_shows_in_the_speed_of_the_wheels() -> None:
    def late(time: np.ndarray) -> np.ndarray:
        return time + np.interp(time - time[0], [0, 15, 25, 40, 60], [0, 0, 1.0, 1.0, 0.2])

    _, pedals = CLEAN.data["pedals"]
    log = MemoryLog({**CLEAN.data, "pedals": (CLEAN.data["wheels"][0], pedals)})
    log = log.restamp("pedals", late).restamp("wheels", late)
    for given in (rig(), None):
        found = [f for f in inspect_log(log, given).findings if f.what == "has a clock that drifts"]
        assert len(found) == 1
        assert "wheels" in found[0].where
        assert 'speed = { topic = "wheels", fields = ["rear"], scale = 0.0' in found[0].remedy


def test_a_heading_in_degrees_and_one_mirrored() -> None:
    _, odom = CLEAN.data["odom"]
    yaw = 2 * np.unwrap(np.arctan2(odom["qz"], odom["qw"]), period=np.pi)
    plain = (QUATERNION, 'fields = ["qz"]'), ("[channels.orientation]", "[channels.yaw]")
    for values, remedy in ((np.degrees(yaw), 'channels.yaw.unit = "deg"'), (-yaw, "channels.yaw.sign = -1")):
        log = CLEAN.change("odom", "qz", lambda _, values=values: values)
        assert remedy in [f.remedy for f in complaints(log, *plain)]
    assert complaints(CLEAN.change("odom", "qz", lambda _: yaw), *plain) == []


@pytest.mark.parametrize(
    ("log", "what"),
    [
        (CLEAN.part({"odom": slice(0, 150)}), "is driven for too short a time"),
        (CLEAN.change("odom", "x", np.zeros_like).change("odom", "y", np.zeros_like), "hardly moves"),
        (MemoryLog({"odom": CLEAN.data["odom"]}), ""),
    ],
)
def test_what_cannot_be_trained_on_is_not_usable(log: MemoryLog, what: str) -> None:
    found = inspect_log(log, rig())
    assert not found.usable
    assert what in [f.what for f in found.findings] or not what


def test_no_control_at_all() -> None:
    found = inspect_log(MemoryLog({"odom": CLEAN.data["odom"]}))
    assert [f.what for f in found.findings if f.severity == "fatal"] == ["there is no control channel"]


def test_steering_alone_is_warned_of() -> None:
    pedals = rig().absent
    without = edited(rig(), [Edit("channels.throttle", None), Edit("channels.brake", None),
                             Edit("absent", ["throttle", "brake", *pedals])])  # fmt: skip
    (finding,) = severe(CLEAN, without)
    assert (finding.severity, finding.what) == ("warning", "there is no throttle")


def test_no_pose_at_all() -> None:
    found = inspect_log(MemoryLog({"pedals": CLEAN.data["pedals"]}))
    assert not found.usable
    assert "pose" in found.findings[0].what


@pytest.mark.parametrize("first", ["x", "y"])
def test_latitude_and_longitude_are_read_in_their_order(first: str) -> None:
    log = CLEAN.change("odom", "x", lambda east: east / 84_880 - 79.95)
    log = log.change("odom", "y", lambda north: north / 111_040 + 40.44)
    read = rig() if first == "x" else rig(('["x", "y", "z"]', '["y", "x", "z"]'))
    found = inspect_log(log, read)
    assert not found.usable
    assert "latitude" in found.findings[0].what
    (cure, *_) = found.findings[0].cures
    assert cure[0] == Edit("channels.position.unit", "lat lon")
    assert cure[1:] == ((Edit("channels.position.fields", ["y", "x", "z"]),) if first == "x" else ())
    assert inspect_log(log, edited(read, cure)).usable


def test_the_draft_reads_the_log_and_is_found_right() -> None:
    drafted = parse_rig(draft_rig(CLEAN), where="draft")
    assert drafted.channels["linear_velocity"].frame == "body"
    assert drafted.channels["steer"].fields == ("command",)
    assert {"brake_pressure", "engine_rpm"} <= set(drafted.absent)
    assert parse_rig(draft_rig(_world(CLEAN)), where="draft").channels["linear_velocity"].frame == "world"


@pytest.mark.parametrize(("scale", "cure"), [(0.04 * 3.6, 'wheel_speed.unit = "km/h"'), (0.02, "wheel_speed.scale = ")])
def test_wheels_in_another_unit_are_found(scale: float, cure: str) -> None:
    wheels = f'[channels.wheel_speed]\ntopic = "wheels"\nfields = ["rear"]\nscale = {scale}\n'
    found = the_only(complaints(CLEAN, ("[channels.position]", f"{wheels}[channels.position]")), "wheel_speed")
    assert found.what == "is not in m/s"
    assert cure in found.remedy


def test_places_in_feet_are_likelier_than_wheels_of_another_size() -> None:
    log = CLEAN
    log = log.change("odom", "x y z", lambda values: values / 0.3048)
    wheels = '[channels.wheel_speed]\ntopic = "wheels"\nfields = ["rear"]\nscale = 0.04\n'
    found = complaints(log, ("[channels.position]", f"{wheels}[channels.position]"))[0]
    assert found.cures[0] == (Edit("channels.position.unit", "ft"),)


def test_velocities_that_stay_zero_are_to_be_removed_from_the_rig() -> None:
    log = CLEAN
    log = log.change("odom", "vx vy wz", np.zeros_like)
    remedies = {f.remedy for f in complaints(log) if f.what == "is zero while the vehicle moves"}
    names = ("linear_velocity", "angular_velocity")
    assert remedies == {f"remove channels.{name}; the pose is differentiated instead" for name in names}


def test_without_a_rig_the_summary_is_of_the_log_as_its_draft_will_be_cured() -> None:
    in_cm = CLEAN
    in_cm = in_cm.change("odom", "x y z", lambda values: 100 * values)
    found = inspect_log(in_cm)
    assert [edit.value for edit in found.cure] == ["cm"]
    assert found.summary.distance == pytest.approx(inspect_log(CLEAN).summary.distance, rel=0.01)


def test_a_steering_whose_sign_is_lost_is_said_to_have_none() -> None:
    """Also where the vehicle turns more to one side, so that its size has an effect."""
    drive = drive_log()
    lost = drive.change("steering", "angle", np.abs).change("steering", "command", np.abs)
    found = [f for f in inspect_log(lost, rig()).findings if f.what == "has no sign"]
    assert {(f.severity, f.where) for f in found} == {("warning", "steer"), ("warning", "steer_angle")}
    one = drive.change("steering", "command", lambda command: 0.2 + np.abs(command))
    assert [f.where for f in inspect_log(one, rig()).findings if f.what == "has no sign"] == ["steer"]
    assert not [f for f in inspect_log(drive, rig()).findings if f.what == "has no sign"]
