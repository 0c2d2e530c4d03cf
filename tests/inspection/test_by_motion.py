"""Controls that only the motion shows: axes of a joystick."""

from dataclasses import replace

import numpy as np
from simulated import MemoryLog, drive_log, rig

from offpiste.inspection.by_motion import find_controls
from offpiste.inspection.missing import why_no_steering
from offpiste.logs.log import Topic
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig


def joystick(seconds: float = 60.0) -> MemoryLog:
    """The drive with its controls as unnamed axes, among others that mean nothing."""
    log = drive_log(seconds=seconds)
    time, pedals = log.data["pedals"]
    steer_time, steering = log.data["steering"]
    steer = np.interp(time, steer_time, steering["angle"])
    noise = np.random.default_rng(0).normal(size=(2, len(time)))
    axes = {
        "axes[0]": -steer,
        "axes[1]": np.cumsum(noise[0]) / 30,
        "axes[2]": 1 - 2 * np.clip(1.25 * pedals["brake"] - 0.25, 0, 1),
        "axes[3]": np.zeros(len(time)),
        "axes[5]": 1 - 2 * np.clip(1.25 * pedals["throttle"] - 0.25, 0, 1),
        "axes[6]": np.sign(noise[1]),
    }
    return MemoryLog({"odom": log.data["odom"], "joy": (time, axes)})


def posed() -> Rig:
    """A rig with the pose alone."""
    gone = ["throttle", "brake", "steer", "steer_angle"]
    given = [name for name in rig().channels if name not in ("position", "orientation")]
    edits = [Edit(f"channels.{name}", None) for name in given]
    return edited(rig(), [*edits, Edit("absent", list(dict.fromkeys((*rig().absent, *gone))))])


def test_the_axes_of_a_joystick_are_found() -> None:
    found = find_controls(joystick(), posed())
    assert {name: guess.fields for name, guess in found.items()} == {
        "steer": ("axes[0]",),
        "throttle": ("axes[5]",),
        "brake": ("axes[2]",),
    }


def test_a_field_that_is_one_control_is_no_rival_of_another() -> None:
    """Of two pedals, the released throttle slows the vehicle more than weak brakes do."""
    log = drive_log(seconds=60, braking=1.0)
    time, pedals = log.data["pedals"]
    joy = {"axes[0]": pedals["throttle"], "axes[1]": pedals["brake"]}
    found = find_controls(MemoryLog({"odom": log.data["odom"], "joy": (time, joy)}), posed())
    assert {name: guess.fields for name, guess in found.items()} == {"throttle": ("axes[0]",), "brake": ("axes[1]",)}


def _radio(seconds: float = 60.0) -> MemoryLog:
    """The drive by radio: one stick drives above its middle and brakes below, and what comes in goes out, too."""
    log = drive_log(seconds=seconds)
    time, pedals = log.data["pedals"]
    steer = np.interp(time, *(log.data["steering"][0], log.data["steering"][1]["angle"]))
    stick = np.clip(2 * (pedals["throttle"] - pedals["brake"]), -1, 1)
    stick[np.abs(stick) < 0.2] = 0.0
    topics = {
        name: (time, {"channels[0]": 1500 + size * steer, "channels[2]": 1500 + size * stick})
        for name, size in (("/rc/in", 500), ("/rc/out", 400))
    }
    return MemoryLog({"odom": log.data["odom"], **topics})


def test_a_stick_of_pulses_that_goes_both_ways_is_a_throttle_and_what_goes_out_is_read() -> None:
    found = find_controls(_radio(), posed())
    throttle = found["throttle"]
    assert (throttle.topic, throttle.fields) == ("/rc/out", ("channels[2]",))
    assert found["steer"].topic == "/rc/out"
    assert "brake" not in found


def test_the_command_of_one_side_and_raw_frames_are_no_control() -> None:
    log = joystick()
    time, axes = log.data["joy"]
    sides = {"track_left": -axes["axes[0]"], "track_right": axes["axes[0]"]}
    tracks = MemoryLog({"odom": log.data["odom"], "tracks/command": (time, sides)})
    assert find_controls(tracks, posed()) == {}
    words = why_no_steering(tracks)
    assert "tracks/command track_left, tracks/command track_right drive one side of the vehicle each" in words
    alone = MemoryLog({"odom": log.data["odom"], "tracks/command": (time, {"track_left": -axes["axes[0]"]})})
    assert find_controls(alone, posed())["steer"].fields == ("track_left",)

    class Bus(MemoryLog):
        @property
        def topics(self) -> dict[str, Topic]:
            types = {"joy": "can_msgs/msg/Frame"}
            return {name: replace(topic, type=types.get(name, topic.type)) for name, topic in super().topics.items()}

    bus = Bus(log.data)
    assert find_controls(bus, posed()) == {}
    assert "joy holds raw CAN frames: decode them with the DBC" in why_no_steering(bus)
    assert why_no_steering(log) == ""
