"""Planted faults, one at a time: each is named alone, and the proposed edits of the rig remove every finding."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from simulated import MAX_STEER, MemoryLog, drive_log, rig, severe

from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.channel import to_z_up
from offpiste.rig.channels import ChannelSource
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import parse_rig

CLEAN = drive_log(seconds=60)
LONG = drive_log()
Fault = Callable[[MemoryLog], MemoryLog]


@pytest.mark.parametrize("seed", range(2))
def test_a_clean_log_raises_nothing_and_is_usable(seed: int) -> None:
    log = drive_log(seed=seed)
    for found in (inspect_log(log, rig()), inspect_log(log)):
        assert found.usable
        assert [f for f in found.findings if f.severity != "note"] == []


def changed(topic: str, fields: str, how: Callable[[np.ndarray], np.ndarray]) -> Fault:
    return lambda log: log.change(topic, fields, how)


def late(topic: str, by: float) -> Fault:
    return lambda log: log.restamp(topic, lambda time: time + by)


def exchanged(topic: str, one: str, other: str) -> Fault:
    def exchange(log: MemoryLog) -> MemoryLog:
        columns = log.data[topic][1]
        return log.put(topic, **{one: columns[other], other: columns[one]})

    return exchange


def in_the_world(log: MemoryLog) -> MemoryLog:
    _, odom = log.data["odom"]
    yaw, vx, vy = 2 * np.arctan2(odom["qz"], odom["qw"]), odom["vx"], odom["vy"]
    return log.put("odom", vx=np.cos(yaw) * vx - np.sin(yaw) * vy, vy=np.sin(yaw) * vx + np.cos(yaw) * vy)


def upside_down(axes: str) -> Fault:
    """A body, and perhaps its world, with z down."""

    def turn(log: MemoryLog) -> MemoryLog:
        fields, odom = ("qx", "qy", "qz", "qw"), log.data["odom"][1]
        values = np.stack([odom[f] for f in fields], axis=1)
        turned = to_z_up("orientation", ChannelSource(fields=fields), values, axes)  # half a turn is its own inverse
        log = log.put("odom", **dict(zip(fields, turned.T, strict=True)))
        return log.change("odom", "y z" if axes == "world down" else "vy vz wy wz", np.negative)

    return turn


def in_milliseconds(log: MemoryLog) -> MemoryLog:
    for topic in log.data:
        log = log.restamp(topic, lambda time: 1e3 * (time - time[0]))
    return log


def out_of_order(*topics: str) -> Fault:
    def shuffle(log: MemoryLog) -> MemoryLog:
        for topic in topics:
            log = log.keep(topic, np.random.default_rng(0).permutation(len(log.data[topic][0])))
        return log

    return shuffle


def with_zero_wxyz(log: MemoryLog) -> MemoryLog:
    _, odom = log.data["odom"]
    return log.put("odom", qx=odom["qw"], qy=odom["qx"], qz=odom["qy"], qw=odom["qz"])


def single_precision(log: MemoryLog) -> MemoryLog:
    """Northings in float32 have steps of 0.5 m, eastings of 0.03 m: the coarser decides."""
    for field, origin in (("x", 412_000), ("y", 5_312_000)):
        log = log.change("odom", field, lambda v, origin=origin: (origin + v).astype(np.float32).astype(float))
    return log


def wrapped(values: np.ndarray) -> np.ndarray:
    """A count in tenths that dips below zero, on the pedal's idle."""
    tenths = np.round(values * 300 - 20, 1)
    return np.where(tenths < 0, tenths + 6553.6, tenths)


def with_spikes(values: np.ndarray) -> np.ndarray:
    values[[700, 1500, 2222]] = (40.0, -33.0, 25.0)
    return values


def steps(size: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda values: np.round(values / size) * size


def right(log: MemoryLog) -> MemoryLog:
    return log


def wheels(scale: float) -> Edit:
    return Edit("channels.wheel_speed", {"topic": "wheels", "fields": ["rear"], "scale": scale})


CONTROLS_LATE = {"channels.steer_angle.delay": 0.33, "channels.steer.delay": 0.42}
PEDALS_LATE = {"channels.brake.delay": 1.1, "channels.throttle.delay": 1.1}
MOTION = ("position", "orientation", "linear_velocity", "angular_velocity")
EXCHANGED_PEDALS = {"channels.throttle.fields": ["brake"], "channels.brake.fields": ["throttle"]}
UNSCALED = {"channels.throttle.wrap": {"above": 3400.0, "period": 6553.6}, "channels.throttle.scale": 1 / 300,
            "channels.throttle.offset": 0.0667}  # fmt: skip
ZEROS = {"channels.linear_velocity": None, "channels.angular_velocity": None}
REVERSED = {"channels.throttle.scale": -1.0, "channels.throttle.offset": 1.0}
UNBRAKED = {"channels.brake.scale": -1.0, "channels.brake.offset": 1.0}
WITHOUT_ANGLE = [Edit("channels.steer_angle", None), Edit("absent", [*rig().absent, "steer_angle"])]
SERVO = [Edit("channels.steer.offset", -0.53), *WITHOUT_ANGLE]
ZEROED_ANGLE = [Edit("channels.steer.offset", -0.05), *WITHOUT_ANGLE]
CUT = "ends short of its range: it is cut off, or in another scale"
STEPS = "is recorded in coarse steps"

FAULTS: dict[str, tuple[MemoryLog, Fault, list[Edit], str, str, Mapping[str, Any]]] = {
    "flipped steering": (CLEAN, changed("steering", "command", np.negative), [], "steer", "is positive to the right",
                         {"channels.steer.sign": -1}),
    "steering 0.3 s late": (CLEAN, late("steering", 0.3), [], "steer_angle",
                            "is stamped after the motion that it causes", CONTROLS_LATE),
    "degrees": (CLEAN, changed("steering", "angle", np.degrees), [], "steer_angle", "leaves its range",
                {"channels.steer_angle.unit": "deg"}),
    "percent": (CLEAN, changed("pedals", "throttle", lambda x: 100 * x), [], "throttle", "leaves its range",
                {"channels.throttle.unit": "percent"}),
    "pedal the wrong way round": (CLEAN, changed("pedals", "throttle", lambda x: 1 - x), [], "throttle",
                                  "acts the wrong way", REVERSED),
    "pedals 1 s late": (CLEAN, late("pedals", 1.0), [], "brake", "is stamped after the motion that it causes",
                        PEDALS_LATE),
    "velocity in the world": (CLEAN, in_the_world, [], "linear_velocity", "is in the world frame, not the body's",
                              {"channels.linear_velocity.frame": "world"}),
    "km/h": (CLEAN, changed("odom", "vx vy", lambda v: 3.6 * v), [], "linear_velocity", "is not in m/s",
             {"channels.linear_velocity.unit": "km/h"}),
    "velocity 0.4 s late": (CLEAN, changed("odom", "vx vy", lambda v: np.roll(v, 20)), [], "linear_velocity",
                            "is late", {"channels.linear_velocity.delay": 0.4}),
    "deg/s": (CLEAN, changed("odom", "wz", np.degrees), [], "angular_velocity", "is not in rad/s",
              {"channels.angular_velocity.unit": "deg/s"}),
    "clockwise rates": (CLEAN, changed("odom", "wz", np.negative), [], "angular_velocity", "has the wrong sign",
                        {"channels.angular_velocity.sign": -1}),
    "wxyz": (CLEAN, with_zero_wxyz, [], "orientation", "the quaternion is stored as w x y z",
             {"channels.orientation.fields": ["qy", "qz", "qw", "qx"]}),
    "millimetres": (CLEAN, changed("odom", "x y", lambda x: 1e3 * x), [], "position", "moves too fast",
                    {"channels.position.unit": "mm"}),
    "wrapped counter": (CLEAN, changed("pedals", "throttle", wrapped), [], "throttle",
                        "wraps around like a 16-bit counter below zero", UNSCALED),
    "spikes": (CLEAN, changed("pedals", "throttle", with_spikes), [], "throttle", "isolated spikes",
               {"channels.throttle.valid": [-0.05, 1.05]}),
    "dead channel": (CLEAN, changed("steering", "angle", np.zeros_like), [], "steer_angle", "never changes",
                     {"channels.steer_angle": None}),
    "rig: sign": (CLEAN, right, [Edit("channels.steer.sign", -1)], "steer", "is positive to the right",
                  {"channels.steer.sign": 1}),
    "rig: delay": (CLEAN, right, [Edit("channels.steer.delay", -0.5)], "steer",
                   "is stamped after the motion that it causes", {"channels.steer.delay": 0.0}),
    "rig: frame": (CLEAN, right, [Edit("channels.linear_velocity.frame", "world")], "linear_velocity",
                   "is in the body frame, not the world's", {"channels.linear_velocity.frame": "body"}),
    "rig: narrow range": (CLEAN, right, [Edit("vehicle.max_steer", 0.1)], "steer", "does not fit the wheels' angle",
                          {"vehicle.max_steer": MAX_STEER}),
    "rig: wide range": (LONG, right, [Edit("vehicle.max_steer", 0.6)], "steer", "does not fit the wheels' angle",
                        {"vehicle.max_steer": MAX_STEER}),
    "rig: unit": (CLEAN, right, [Edit("channels.steer_angle.unit", "deg")], "steer_angle", "does not fit the command",
                  {"channels.steer_angle.unit": "rad"}),
    "rig: percent": (CLEAN, right, [Edit("channels.brake.unit", "percent")], "brake", "is too small for what it does",
                     {"channels.brake.unit": "1"}),
    "rig: valid": (LONG, right, [Edit("channels.steer.valid", [-0.3, 0.3])], "steer", "valid drops measurements",
                   {"channels.steer.valid": [-1.1, 1.1]}),
    "another signal": (CLEAN, changed("steering", "command", lambda x: np.random.default_rng(3).uniform(-1, 1, len(x))),
                       [], "steer", "does not turn the vehicle", {}),
    "a jump": (CLEAN, changed("odom", "x", lambda x: x + 4.0 * (np.arange(len(x)) >= 2500)), [], "position", "jumps",
               {}),
    "wheels in km/h": (CLEAN, right, [wheels(0.04 * 3.6)], "wheel_speed", "is not in m/s",
                       {"channels.wheel_speed.unit": "km/h"}),
    "wheels of another size": (CLEAN, right, [wheels(0.02)], "wheel_speed", "is not in m/s",
                               {"channels.wheel_speed.scale": 0.04}),
    "feet": (CLEAN, changed("odom", "x y z", lambda v: v / 0.3048), [wheels(0.04)], "position", "moves too fast",
             {"channels.position.unit": "ft"}),
    "velocities that stay zero": (CLEAN, changed("odom", "vx vy wz", np.zeros_like), [],
                                  "linear_velocity angular_velocity", "is zero while the vehicle moves", ZEROS),
    "idle offset": (CLEAN, changed("pedals", "throttle", lambda x: 0.2 + 0.8 * x), [], "throttle",
                    "never comes back to zero", {"channels.throttle.offset": -0.2}),
    "swapped pedals": (CLEAN, exchanged("pedals", "throttle", "brake"), [], "brake", "acts the wrong way",
                       EXCHANGED_PEDALS),
    "dead brake": (CLEAN, changed("pedals", "brake", np.zeros_like), [], "brake",
                   "is never pressed, and the vehicle brakes", {"channels.brake": None}),
    "brake never released": (CLEAN, changed("pedals", "brake", lambda x: 1 - 0.7 * (np.arange(len(x)) % 500 < 30)), [],
                             "brake", "is pressed all the time", UNBRAKED),
    "hundredths": (CLEAN, changed("pedals", "throttle", lambda x: 0.01 * x), [], "throttle",
                   "is too small for what it does", {"channels.throttle.scale": 100.0}),
    "steering off its centre": (LONG, changed("steering", "command", lambda v: v - 0.2), [], "steer",
                                "is not zero straight ahead", {"channels.steer.offset": 0.2}),
    "places of no unit": (LONG, changed("odom", "x y z", lambda v: 2 * v), [Edit("channels.linear_velocity", None)],
                          "steer", "turns the vehicle less than the rig says", {"channels.position.scale": 0.5}),
    "servo without a scale": (LONG, changed("steering", "command", lambda v: 0.53 + 0.2 * v), SERVO, "steer",
                              "turns the vehicle more than the rig says", {"channels.steer.scale": 5.1}),
    "scale of the angle": (LONG, changed("steering", "angle", lambda v: 1.5 * v), [], "steer_angle",
                           "does not fit the command", {"channels.steer_angle.scale": 1 / 1.5}),
    "range of no vehicle": (LONG, changed("steering", "command", lambda v: 0.3 * v), [], "steer",
                            "does not fit the wheels' angle", {"channels.steer.scale": 1 / 0.3}),
    "command in radians": (LONG, changed("steering", "command", lambda v: MAX_STEER * v), WITHOUT_ANGLE, "steer",
                           "turns the vehicle more than the rig says", {"channels.steer.unit": "rad"}),
    "command in radians, its zero elsewhere": (LONG, changed("steering", "command", lambda v: MAX_STEER * v + 0.05),
                                               ZEROED_ANGLE, "steer", "turns the vehicle more than the rig says",
                                               {"channels.steer.unit": "rad"}),
    "body with z down": (CLEAN, upside_down("body down"), [], "orientation", "the body's z axis points down",
                         {"motion.axes": "body down"}),
    "world with z down": (CLEAN, upside_down("world down"), [], "orientation", "the body's z axis points down",
                          {"motion.axes": "world down"}),
    "swapped axes": (CLEAN, exchanged("odom", "x", "y"), [], "orientation", "the heading does not follow the course",
                     {"channels.position.fields": ["y", "x", "z"]}),
    "rows out of order": (CLEAN, out_of_order("odom"), [], "odom", "samples are not in the order of their stamps",
                          {"clock.sort": True}),
    "all rows out of order": (CLEAN, out_of_order(*CLEAN.data), [], "odom pedals steering wheels",
                              "samples are not in the order of their stamps", {"clock.sort": True}),
    "poses 0.6 s early": (CLEAN, late("odom", -0.6), [], "position", "is early",
                          {f"channels.{name}.delay": -0.65 for name in MOTION}),
    "milliseconds": (CLEAN, in_milliseconds, [], "odom", "stamps are in another unit", {"clock.unit": "ms"}),
    "no sign": (LONG, changed("steering", "angle command", np.abs), [], "steer steer_angle", "has no sign", {}),
    "throttle cut off": (LONG, changed("pedals", "throttle", lambda v: np.clip(v, -0.4, 0.4)), [], "throttle", CUT, {}),
    "steering cut off": (LONG, changed("steering", "command", lambda v: np.clip(v, -0.3, 0.3)), [], "steer",
                         "is cut off at its largest value", {}),
    "angle cut off": (LONG, changed("steering", "angle", lambda v: np.clip(v, -0.1, 0.1)), [], "steer_angle",
                      "is cut off at its largest value", {}),
    "places in coarse steps": (LONG, changed("odom", "x y", steps(0.5)), [], "position", STEPS, {}),
    "steering in coarse steps": (LONG, changed("steering", "command", steps(0.3)), [], "steer", STEPS, {}),
    "single precision": (LONG, single_precision, [], "position", STEPS, {}),
}  # fmt: skip
"""Log, change of it, edits of the right rig, channels or topics that are named, what is said, and the fix."""


@pytest.mark.parametrize(("log", "fault", "edits", "where", "what", "fix"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_named_with_the_edits_that_fix_it(
    log: MemoryLog, fault: Fault, edits: list[Edit], where: str, what: str, fix: Mapping[str, Any]
) -> None:
    log, given = fault(log), edited(rig(), edits)
    found = inspect_log(log, given)
    serious = [finding for finding in found.findings if finding.severity != "note"]
    assert any(what in finding.what for finding in serious)
    assert {place.split(" ")[0] for f in serious for place in f.where.split(", ")} <= set(where.split())
    assert all(any(character.isdigit() for character in finding.evidence) for finding in serious)
    cure = {edit.key: edit.value for edit in found.cure if edit.key != "absent"}
    assert cure.keys() >= fix.keys()
    assert bool(cure) == bool(fix)
    for key, value in fix.items():
        assert cure[key] == (pytest.approx(value, abs=0.15) if isinstance(value, float) else value)
    if fix:
        assert severe(log, edited(given, found.cure)) == []


def test_a_drifting_clock_shows_in_the_speed_of_the_wheels() -> None:
    def drifting(time: np.ndarray) -> np.ndarray:
        return time + np.interp(time - time[0], [0, 15, 25, 40, 60], [0, 0, 1.0, 1.0, 0.2])

    _, pedals = CLEAN.data["pedals"]
    log = MemoryLog({**CLEAN.data, "pedals": (CLEAN.data["wheels"][0], pedals)})
    log = log.restamp("pedals", drifting).restamp("wheels", drifting)
    for given in (rig(), None):
        found = [f for f in inspect_log(log, given).findings if f.what == "has a clock that drifts"]
        assert len(found) == 1
        assert "wheels" in found[0].where
        assert 'speed = { topic = "wheels", fields = ["rear"], scale = 0.0' in found[0].remedy


def test_a_heading_in_degrees_and_one_mirrored() -> None:
    _, odom = CLEAN.data["odom"]
    yaw = 2 * np.unwrap(np.arctan2(odom["qz"], odom["qw"]), period=np.pi)
    given = edited(rig(), [Edit("channels.orientation", None),
                           Edit("channels.yaw", {"topic": "odom", "fields": ["qz"]})])  # fmt: skip
    for values, fix in ((np.degrees(yaw), Edit("channels.yaw.unit", "deg")), (-yaw, Edit("channels.yaw.sign", -1))):
        assert fix in inspect_log(CLEAN.put("odom", qz=values), given).cure
    assert severe(CLEAN.put("odom", qz=yaw), given) == []


NO_PEDALS = edited(rig(), [Edit("channels.throttle", None), Edit("channels.brake", None),
                           Edit("absent", ["throttle", "brake", *rig().absent])])  # fmt: skip


@pytest.mark.parametrize(
    ("log", "given", "severity", "what"),
    [
        (CLEAN.part({"odom": slice(0, 150)}), rig(), "fatal", "drives for too short a time"),
        (CLEAN.change("odom", "x y", np.zeros_like), rig(), "fatal", "hardly moves"),
        (MemoryLog({"odom": CLEAN.data["odom"]}), None, "fatal", "there is no control channel"),
        (
            MemoryLog({"pedals": CLEAN.data["pedals"]}),
            None,
            "fatal",
            "no topic looks like a pose (position and heading)",
        ),
        (CLEAN, NO_PEDALS, "warning", "there is no throttle"),
    ],
)
def test_what_a_log_lacks_is_named(log, given, severity, what) -> None:
    assert (severity, what) in {(f.severity, f.what) for f in inspect_log(log, given).findings}


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
    assert parse_rig(draft_rig(in_the_world(CLEAN)), where="draft").channels["linear_velocity"].frame == "world"


def test_without_a_rig_the_summary_is_of_the_log_as_its_draft_will_be_fixed() -> None:
    found = inspect_log(CLEAN.change("odom", "x y z", lambda values: 100 * values))
    assert [edit.value for edit in found.cure] == ["cm"]
    assert found.summary.distance == pytest.approx(inspect_log(CLEAN).summary.distance, rel=0.01)
