"""Logs of a drive as many loggers write them (loggers.toml)."""

import dataclasses
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated import MAX_STEER, WHEELBASE, MemoryLog, drive_log, severe

from offpiste.inspection.draft_rig import draft_rig
from offpiste.logs.log import Log as TopicLog
from offpiste.logs.log import Topic
from offpiste.rig.edits import edited
from offpiste.rig.rig import Rig, parse_rig

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
    return ODOM | {
        "0": 0 * TIME,
        "1": 0 * TIME + 1,
        "throttle": throttle,
        "brake": brake,
        "pedal": throttle - brake,
        "steer": steer,
        "angle": angle,
        "early steer": np.interp(TIME + 0.2, steered, steering["command"]),
        "late angle": np.interp(TIME - 0.05, steered, steering["angle"]),
        "curvature": np.tan(MAX_STEER * steer) / WHEELBASE,
        "speed command": np.interp(TIME + 0.4, TIME, ODOM["vx"]),
        "latitude": 47.4 + ODOM["y"] / 111_180,
        "longitude": 8.5 + ODOM["x"] / 75_500,
        "height": 450 + ODOM["z"],
        "east": np.cos(YAW) * ODOM["vx"] - np.sin(YAW) * ODOM["vy"],
        "north": np.sin(YAW) * ODOM["vx"] + np.cos(YAW) * ODOM["vy"],
        "azimuth": np.rad2deg(np.pi / 2 - YAW) % 360,
        "azimuth in rad": (np.pi / 2 - YAW) % (2 * np.pi),
        "half azimuth cos": np.cos((np.pi / 2 - YAW) / 2),
        "half azimuth sin": np.sin((np.pi / 2 - YAW) / 2),
        "noise": 1 + 0.02 * np.random.default_rng(0).standard_normal(len(TIME)),
    }


QUANTITIES = _quantities()
_LINEAR = re.compile(r"(round )?(?:(\S+) ([+-]) )?(?:([-.e\d]+) )?(\D.*|[01])")
"""A quantity with a factor and an offset: `1500 - 400 steer`, `round 1e7 latitude`."""


def recorded(text: str) -> np.ndarray:
    """The numbers that a field holds, from a quantity with its factor and offset."""
    whole, offset, sign, factor, name = _LINEAR.fullmatch(text).groups()
    values = float(offset or 0) + float(f"{sign or ''}1") * float(factor or 1) * QUANTITIES[name]
    return np.round(values) if whole else values


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
    return Log({name: (TIME, {f: recorded(q) for f, q in fields.items()}) for name, fields in topics.items()})


def table(columns: Mapping[str, str]) -> MemoryLog:
    """A table with the quantities of columns."""
    return MemoryLog({"": (TIME, {name: recorded(quantity) for name, quantity in columns.items()})})


def logger(name: str) -> MemoryLog:
    """The drive as a logger of the table writes it."""
    topics, more = LOGGERS[name]["topics"], LOGGERS[name]
    if "" in topics:
        return table(topics[""] | (PEDALS if more.get("pedals") else {}))
    poses = {more[kind]: fields for kind, fields in (("odometry", POSE), ("odom", PLAIN)) if kind in more}
    log = log_of(poses | topics | (COMMANDS if more.get("commands") else {}))
    log.types, log.joints = more.get("types", {}), more.get("joints", {})
    return log


def drafted(log: TopicLog, namespace: str = "") -> Rig:
    """The first rig of a log."""
    return parse_rig(draft_rig(log, namespace), where="draft")


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
