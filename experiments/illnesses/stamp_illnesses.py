"""Illnesses of stamps and rows: delays, drifting clocks, order, repeats, gaps, losses."""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from experiments.illnesses.illness import Change, illness, some_rows
from experiments.illnesses.recording import Case

_DELAYS: Final = (-0.5, -0.2, -0.1, 0.1, 0.2, 0.5, 1.0)
_POSE: Final = ("position", "orientation", "yaw")


def delayed(case: Case, channel: str, late: float) -> Case:
    """A channel stamped `late` after it happened [s]: by the stamps of a topic of its own, else by its values."""
    source = case.source(channel)
    if case.readers(source.topic) == (channel,):
        return case.with_stamps(source.topic, lambda time: time + late)
    time, values = case.stream(channel).time, case.values(channel)
    order = np.argsort(time, kind="stable")
    moved = np.stack([np.interp(time - late, time[order], column[order]) for column in values.T], axis=1)
    return case.with_values(channel, moved)


def _declare_delay(channel: str, consequences: tuple[str, ...] = ()) -> None:
    @illness(f"{channel}: delay", "stamps", _DELAYS, "s", (channel,), consequences=consequences, curable=True)
    def _change(case: Case, strength: float, random: np.random.Generator) -> Case:
        return delayed(case, channel, strength)


for _channel in ("steer", "steer_angle", "throttle", "brake", "linear_velocity", "yaw_rate", "wheel_speed"):
    _declare_delay(_channel)


@illness(
    "pose: delay", "stamps", _DELAYS, "s", _POSE, needs=(), curable=True,
    consequences=("steer", "steer_angle", "throttle", "brake", "linear_velocity", "yaw_rate", "angular_velocity",
                  "wheel_speed"),
)  # fmt: skip
def _pose_delay(case: Case, strength: float, random: np.random.Generator) -> Case:
    for channel in _POSE:
        if case.has(channel):
            case = _moved_pose(case, channel, strength)
    return case


def _moved_pose(case: Case, channel: str, late: float) -> Case:
    time, values = case.stream(channel).time, case.values(channel)
    if channel == "yaw":
        values = np.unwrap(values, axis=0)
    if channel == "orientation":
        flips = np.sum(values[1:] * values[:-1], axis=1) < 0
        values = values * np.where(np.append(0, np.cumsum(flips)) % 2, -1.0, 1.0)[:, None]
    moved = np.stack([np.interp(time - late, time, column) for column in values.T], axis=1)
    if channel == "orientation":
        moved /= np.linalg.norm(moved, axis=1, keepdims=True)
    return case.with_values(channel, moved)


@illness("heading: delay", "stamps", _DELAYS, "s", ("orientation", "yaw"), needs=(), curable=True,
         consequences=("yaw_rate", "angular_velocity", "linear_velocity", "steer", "steer_angle"))  # fmt: skip
def _heading_delay(case: Case, strength: float, random: np.random.Generator) -> Case:
    return _moved_pose(case, "yaw" if case.has("yaw") else "orientation", strength)


@illness("steer: clock drifts", "stamps", (0.3, 0.6, 1.0, 2.0), "s over the log", ("steer",))
def _drifting(case: Case, strength: float, random: np.random.Generator) -> Case:
    topic = case.source("steer").topic
    if case.readers(topic) != ("steer",):
        time, values = case.stream("steer").time, case.values("steer")[:, 0]
        late = strength * (time - time[0]) / np.ptp(time)
        return case.with_values("steer", np.interp(time - late, time, values)[:, None])
    return case.with_stamps(topic, lambda time: time + strength * (time - time[0]) / np.ptp(time))


@illness(
    "controls: clock drifts",
    "stamps",
    (0.5, 1.0, 2.0),
    "s",
    ("wheel_speed", "throttle", "brake", "steer"),
    needs=("wheel_speed", "throttle", "topics"),
    consequences=("steer_angle", "brake_pressure", "engine_rpm"),
)
def _bus_drifts(case: Case, strength: float, random: np.random.Generator) -> Case:
    """All that the vehicle's bus carries: between nothing and the strength late, changing over half minutes."""
    pose = case.source("position").topic
    span = case.stream("position").time
    knots = np.arange(span[0] - 30, span[-1] + 60, 20.0)
    lags = random.uniform(0, strength, len(knots))
    for topic in case.streams:
        if topic == pose or topic == "imu":
            continue
        case = case.with_stamps(topic, lambda time: time + np.interp(time, knots, lags))
    return case


def _rows(name: str, strengths: tuple[float, ...], unit: str, channel: str, *needs: str) -> Callable[..., Change]:
    """An illness of the rows of the topic that `channel` comes from."""
    wanted = (channel, *needs)
    return illness(f"{channel}: {name}", "stamps", strengths, unit, (channel,), consequences=("stamps",), needs=wanted)


for _channel in ("position", "steer"):

    @_rows("rows shuffled", (0.01, 0.1, 1.0), "of the rows", _channel)
    def _shuffled(case: Case, strength: float, random: np.random.Generator, channel: str = _channel) -> Case:
        def choose(count: int) -> np.ndarray:
            order = np.arange(count)
            moved = random.random(count) < strength
            order[moved] = random.permutation(order[moved])
            return order

        return case.with_rows(case.source(channel).topic, choose)

    @_rows("rows repeated", (0.05, 0.3, 0.6), "of the rows", _channel)
    def _repeated(case: Case, strength: float, random: np.random.Generator, channel: str = _channel) -> Case:
        def choose(count: int) -> np.ndarray:
            return np.repeat(np.arange(count), 1 + (random.random(count) < strength))

        return case.with_rows(case.source(channel).topic, choose)

    @_rows("stamps repeat", (0.1, 0.3, 0.6), "of the stamps", _channel)
    def _stamps_repeat(case: Case, strength: float, random: np.random.Generator, channel: str = _channel) -> Case:
        """Some samples carry the stamp of the one before."""

        def change(time: np.ndarray) -> np.ndarray:
            again = random.random(len(time)) < strength
            again[0] = False
            first: np.ndarray = time[np.maximum.accumulate(np.where(again, 0, np.arange(len(time))))]
            return first

        return case.with_stamps(case.source(channel).topic, change)

    @_rows("stamps go back", (1.0, 3.0, 10.0), "times", _channel)
    def _backwards(case: Case, strength: float, random: np.random.Generator, channel: str = _channel) -> Case:
        """Now and then the clock is set back by up to a second."""

        def change(time: np.ndarray) -> np.ndarray:
            for row in random.choice(len(time), int(strength), replace=False):
                time[row:] -= random.uniform(0.1, 1.0)
            return time

        return case.with_stamps(case.source(channel).topic, change)

    @_rows("gaps", (1.0, 3.0, 10.0), "of 2 s", _channel)
    def _gaps(case: Case, strength: float, random: np.random.Generator, channel: str = _channel) -> Case:
        topic = case.source(channel).topic
        time = case.streams[topic].time
        keep = np.ones(len(time), bool)
        for start in random.uniform(time[0], time[-1] - 2, int(strength)):
            keep &= (time < start) | (time > start + 2)
        return case.with_rows(topic, lambda count: keep)

    @_rows("losses", (0.05, 0.2, 0.5), "of the samples", _channel)
    def _losses(case: Case, strength: float, random: np.random.Generator, channel: str = _channel) -> Case:
        return case.with_rows(case.source(channel).topic, lambda count: random.random(count) > strength)

    @_rows("truncated", (0.1, 0.3, 0.6), "of the log", _channel, "topics")  # a table that ends is a shorter log
    def _truncated(case: Case, strength: float, random: np.random.Generator, channel: str = _channel) -> Case:
        return case.with_rows(case.source(channel).topic, lambda count: np.arange(count) < (1 - strength) * count)

    @_rows("stamps not finite", (1.0, 10.0, 100.0), "samples", _channel)
    def _no_stamps(case: Case, strength: float, random: np.random.Generator, channel: str = _channel) -> Case:
        def change(time: np.ndarray) -> np.ndarray:
            time[some_rows(len(time), int(strength), random)] = np.nan
            return time

        return case.with_stamps(case.source(channel).topic, change)


def _of_all(name: str, strengths: tuple[float, ...], unit: str) -> Callable[..., Change]:
    places = ("position", "steer", "throttle", "clock", "log")
    return illness(name, "stamps", strengths, unit, places, needs=(), consequences=("stamps",), curable=True)


@_of_all("stamps in another unit", (1e3, 1e6, 1e9), "times")
def _unit(case: Case, strength: float, random: np.random.Generator) -> Case:
    for topic in case.streams:
        case = case.with_stamps(topic, lambda time: time * strength)
    return case


@illness(
    "steer: header clock apart",
    "stamps",
    (0.6, 2.0, 30.0, 3600.0),
    "s",
    ("steer",),
    needs=("steer", "topics"),
    consequences=("throttle", "brake"),
    curable=True,
)
def _clock_apart(case: Case, strength: float, random: np.random.Generator) -> Case:
    """Headers by a clock that is slow; messages still arrive in time."""
    topic = case.source("steer").topic
    stream = case.streams[topic]
    return case.with_stream(topic, replace(stream, time=stream.time - strength))
