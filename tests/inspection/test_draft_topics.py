"""First rigs of logs whose pose is spread over topics, and of controls with the names that loggers use."""

import dataclasses

import numpy as np
import pytest
from simulated import MemoryLog, drive_log

from offpiste.inspection.channel_guesses import guess_channels
from offpiste.inspection.draft_rig import draft_rig
from offpiste.logs.log import Topic
from offpiste.rig.rig import Rig, parse_rig

CLEAN = drive_log(seed=0)
TIME, ODOM = CLEAN.data["odom"]


class Typed(MemoryLog):
    """Topics whose names end in their type."""

    @property
    def topics(self) -> dict[str, Topic]:
        return {name: dataclasses.replace(topic, type=name.split("/")[-1]) for name, topic in super().topics.items()}


def _receiver_and_imu(sign: float = 1.0) -> Typed:
    """A GNSS receiver at 10 Hz, an IMU and a gamepad."""
    rows = np.arange(0, len(TIME), max(round(0.1 / float(np.median(np.diff(TIME)))), 1))
    fix = {"latitude": 47.4 + ODOM["y"] / 111_180, "longitude": 8.5 + ODOM["x"] / 75_500, "altitude": 450 + ODOM["z"]}
    half = sign * np.arctan2(ODOM["qz"], ODOM["qw"])
    turned = {"orientation.x": 0 * half, "orientation.y": 0 * half, "orientation.z": np.sin(half),
              "orientation.w": np.cos(half), "angular_velocity.x": ODOM["wx"], "angular_velocity.y": ODOM["wy"],
              "angular_velocity.z": ODOM["wz"]}  # fmt: skip
    time, pedals = CLEAN.data["pedals"]
    steer = np.interp(time, CLEAN.data["steering"][0], CLEAN.data["steering"][1]["command"])
    axes = {"axes[0]": steer, "axes[1]": 0 * time, "axes[2]": 1 - 2 * pedals["brake"],
            "axes[5]": 1 - 2 * pedals["throttle"]}  # fmt: skip
    log = {"gnss/NavSatFix": (TIME[rows], {name: values[rows] for name, values in fix.items()})}
    return Typed(log | {"imu/Imu": (TIME, turned), "joy/Joy": (time, axes)})


def _drafted(log: MemoryLog) -> Rig:
    return parse_rig(draft_rig(log), where="draft")


def test_a_receiver_an_imu_and_a_gamepad_make_a_rig() -> None:
    channels = _drafted(_receiver_and_imu()).channels
    assert (channels["position"].topic, channels["position"].unit) == ("gnss/NavSatFix", "lat lon")
    assert channels["orientation"].topic == channels["angular_velocity"].topic == "imu/Imu"
    assert channels["steer"].fields == ("axes[0]",)
    assert channels["throttle"].fields == ("axes[5]",)


def test_rates_of_an_imu_stand_beside_a_pose_that_has_none() -> None:
    pose = {name: values for name, values in ODOM.items() if name[0] not in "vw"}
    log = Typed(CLEAN.data | {"odom": (TIME, pose), "imu/Imu": _receiver_and_imu().data["imu/Imu"]})
    channels = _drafted(log).channels
    assert channels["orientation"].topic == "odom"
    assert channels["angular_velocity"].topic == "imu/Imu"


@pytest.mark.parametrize(
    ("field", "channel"),
    [("thr_pct", "throttle"), ("brk_pct", "brake"), ("str_cmd", "steer"), ("commands/servo/position", "steer")],
)
def test_short_names_of_loggers(field: str, channel: str) -> None:
    log = MemoryLog({"table": (TIME, {"a": TIME, field: np.sin(TIME), "b": TIME})})
    assert (channel, (field,)) in {(guess.channel, guess.fields) for guess in guess_channels(log)}


@pytest.mark.parametrize("field", ["stream", "thread", "string_length", "strength"])
def test_words_that_only_begin_like_them(field: str) -> None:
    log = MemoryLog({"table": (TIME, {"a": TIME, field: np.sin(TIME), "b": TIME})})
    assert not {guess.channel for guess in guess_channels(log)} & {"throttle", "brake", "steer"}


def test_a_height_beside_east_and_north_is_read() -> None:
    log = MemoryLog({"table": (TIME, {"utm_e": ODOM["x"], "utm_n": ODOM["y"], "alt": ODOM["z"], "hdg": TIME})})
    (place,) = (guess for guess in guess_channels(log) if guess.channel == "position")
    assert place.fields == ("utm_e", "utm_n", "alt")


def test_a_servo_is_read_around_its_middle() -> None:
    servo = CLEAN.change("steering", "command", lambda values: 0.53 + 0.3 * values)
    time, columns = servo.data.pop("steering")
    log = MemoryLog(servo.data | {"servo": (time, {"position": columns["command"]})})
    steer = _drafted(log).channels["steer"]
    assert (steer.scale, steer.offset) == (2.0, -1.0)


def test_a_clockwise_heading_does_not_hide_the_controls() -> None:
    yaw = 2 * np.arctan2(ODOM["qz"], ODOM["qw"])
    time, axes = _receiver_and_imu().data["joy/Joy"]
    pose = {"x": ODOM["x"], "y": ODOM["y"], "heading": np.degrees(np.pi / 2 - yaw) % 360}
    channels = _drafted(Typed({"pose": (TIME, pose), "joy/Joy": (time, axes)})).channels
    assert channels["steer"].fields == ("axes[0]",)
