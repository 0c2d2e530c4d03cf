"""Logs of a drive as many loggers write them (loggers.toml)."""

import dataclasses
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated import MAX_STEER, WHEELBASE, MemoryLog, drive_log, severe

from offpiste.logs.log import Topic
from offpiste.rig.edits import edited
from offpiste.rig.rig import Rig

LOGGERS: Mapping[str, dict[str, Any]] = tomllib.loads(Path(__file__).with_name("loggers.toml").read_text("utf-8"))
CLEAN = drive_log()
TIME, ODOM = CLEAN.data["odom"]
YAW = 2 * np.arctan2(ODOM["qz"], ODOM["qw"])
POSE = {f"pose.pose.position.{axis}": axis for axis in "xyz"}
POSE |= {f"pose.pose.orientation.{axis}": f"q{axis}" for axis in "xyzw"}
PEDALS = {"throttle": "throttle", "brake": "brake", "steer": "steer"}
PLAIN = {field: field for field in ODOM}
COMMANDS = {"/cmd": PEDALS}


def _quantities() -> dict[str, np.ndarray]:
    """What a vehicle's messages hold, by the poses' stamps."""
    (time, pedals), (steered, steering) = CLEAN.data["pedals"], CLEAN.data["steering"]
    throttle, brake = (np.interp(TIME, time, pedals[name]) for name in ("throttle", "brake"))
    steer, angle = (np.interp(TIME, steered, steering[name]) for name in ("command", "angle"))
    latitude, longitude = 47.4 + ODOM["y"] / 111_180, 8.5 + ODOM["x"] / 75_500
    east = np.cos(YAW) * ODOM["vx"] - np.sin(YAW) * ODOM["vy"]
    north = np.sin(YAW) * ODOM["vx"] + np.cos(YAW) * ODOM["vy"]
    azimuth, height = np.rad2deg(np.pi / 2 - YAW) % 360, 450 + ODOM["z"]
    return ODOM | {
        "0": 0 * TIME,
        "1": 0 * TIME + 1,
        "throttle": throttle,
        "brake": brake,
        "steer": steer,
        "angle": angle,
        "latitude": latitude,
        "longitude": longitude,
        "height": height,
        "east": east,
        "north": north,
        "azimuth": azimuth,
        "azimuth in rad": np.deg2rad(azimuth),
        "azimuth in hundredths": np.round(100 * azimuth),
        "latitude in rad": np.deg2rad(latitude),
        "longitude in rad": np.deg2rad(longitude),
        "counted latitude": np.round(1e7 * latitude),
        "counted longitude": np.round(1e7 * longitude),
        "counted height": np.round(1e3 * height),
        "counted azimuth": np.round(1e5 * azimuth),
        "counted north": np.round(1e3 * north),
        "counted east": np.round(1e3 * east),
        "down": -ODOM["z"],
        "sinking": -ODOM["vz"],
        "right": -ODOM["wy"],
        "clockwise": -ODOM["wz"],
        "half azimuth cos": np.cos((np.pi / 2 - YAW) / 2),
        "half azimuth sin": np.sin((np.pi / 2 - YAW) / 2),
        "wheel": 14 * angle,
        "wheel in deg": 800 * angle,
        "wheel command in deg": 800 * MAX_STEER * steer,
        "tire command": MAX_STEER * steer,
        "curvature": np.tan(MAX_STEER * steer) / WHEELBASE,
        "steering from 0 to 1": (0.9 * steer + 1) / 2,
        "revolutions": 1000 + 300 * ODOM["vx"],
        "speed command": np.interp(TIME + 0.4, TIME, ODOM["vx"]),
        "duty": ODOM["vx"] / 20,
        "throttle in %": 100 * throttle,
        "brake in %": 100 * brake,
        "brake in bar": 60 * brake,
        "brake in C": 300 + 50 * brake,
        "brake trigger": 1 - 2 * brake,
        "throttle trigger": 1 - 2 * throttle,
        "throttle of 255": 255 * throttle,
        "brake to 153 of 255": 153 * brake,
        "early steer of 0 to 1023": 511.5 * (np.interp(TIME + 0.2, steered, steering["command"]) + 1),
        "late angle in deg": np.rad2deg(np.interp(TIME - 0.05, steered, steering["angle"])),
        "steering pulse": 1500 - 400 * steer,
        "throttle pulse": 1500 + 400 * (throttle - brake),
        "middle pulse": 0 * TIME + 1500,
        "noise": 1 + 0.02 * np.random.default_rng(0).standard_normal(len(TIME)),
    }


QUANTITIES = _quantities()


class Log(MemoryLog):
    """Topics of which most have messages of another type than those that the drafts know."""

    types: Mapping[str, str] = {}
    joints: Mapping[str, Mapping[str, str]] = {}

    @property
    def topics(self) -> dict[str, Topic]:
        return {
            name: dataclasses.replace(topic, type=self.types.get(name, "x/msg/X"), joints=self.joints.get(name, {}))
            for name, topic in super().topics.items()
        }


def log_of(topics: Mapping[str, Mapping[str, str]]) -> Log:
    """A log of topics with the quantities of fields."""
    return Log({name: (TIME, {f: QUANTITIES[q] for f, q in fields.items()}) for name, fields in topics.items()})


def table(columns: Mapping[str, str]) -> MemoryLog:
    """A table with the quantities of columns."""
    return MemoryLog({"": (TIME, {name: QUANTITIES[quantity] for name, quantity in columns.items()})})


def logger(name: str) -> MemoryLog:
    """The drive as a logger of the table writes it."""
    topics, more = LOGGERS[name]["topics"], LOGGERS[name]
    if "" in topics:
        return table(topics[""] | (PEDALS if more.get("pedals") else {}))
    poses = {more[kind]: fields for kind, fields in (("odometry", POSE), ("odom", PLAIN)) if kind in more}
    log = log_of(poses | topics | (COMMANDS if more.get("commands") else {}))
    log.types, log.joints = more.get("types", {}), more.get("joints", {})
    return log


def assert_drafted(rig: Rig, channels: Mapping[str, Any]) -> None:
    """Assert that a rig has channels with these fields, or with these settings."""
    for channel, wanted in channels.items():
        settings = wanted if isinstance(wanted, dict) else {"fields": wanted}
        source = rig.channels[channel]
        drafted = {key: getattr(source, key) for key in settings}
        expected = {key: tuple(v) if isinstance(v, list) else v for key, v in settings.items()}
        assert drafted == {k: pytest.approx(v, rel=1e-3) if isinstance(v, float) else v for k, v in expected.items()}


def cured(log: MemoryLog, rig: Rig) -> list[str]:
    """What is left of the warnings once the rig has the first cures."""
    for _ in range(3):
        findings = severe(log, rig)
        if not any(f.cures for f in findings):
            break
        rig = edited(rig, [edit for f in findings for edit in (f.cures[0] if f.cures else ())])
    return [f"{f.where} {f.what}" for f in findings]
