"""Table of faults: each has graded strengths, the channels a finding may point to, and a change of a case."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.inspection_faults.recording import Case
from offpiste.core.errors import OffpisteError
from offpiste.core.geometry import rotation_from_quaternion, same_sign

Random = np.random.Generator
Change = Callable[[Case, float, Random], Case]
Values = Callable[[np.ndarray, float, Random], np.ndarray]
"""Changes the values [n, k] of a channel."""


@dataclass(frozen=True)
class Fault:
    """A fault of a recording or its rig, or a change that no finding may point to (kind "healthy")."""

    name: str
    kind: str  # "channel", "stamps", "pose", "rig" or "healthy"
    strengths: tuple[float, ...]  # the weakest first
    unit: str
    places: tuple[str, ...]  # channels that a finding may point to; their topics count as well
    change: Change
    consequences: tuple[str, ...] = ()  # where it may show too; such findings neither find it nor are false alarms
    needs: tuple[str, ...] | None = None  # what the recording must have (`recorded`); `places` by default
    fixable: bool = False  # whether entries of the rig undo it
    convention: bool = False  # whether it is a constant scale without a unit: right if equal in training and driving

    @property
    def needed(self) -> tuple[str, ...]:
        """Channels, and more, that the recording must have."""
        return self.places if self.needs is None else self.needs


def fault_named(name: str) -> Fault:
    """Return a fault by name.

    Raises:
        OffpisteError: there is none.
    """
    if name not in FAULTS:
        raise OffpisteError(f"there is no fault '{name}'", how="--list prints the names")
    return FAULTS[name]


def some_rows(count: int, length: int, random: Random) -> slice:
    """A run of rows within the middle 80 % of a recording."""
    length = min(length, max(count // 4, 1))
    first = int(random.integers(count // 10, max(9 * count // 10 - length, count // 10 + 1)))
    return slice(first, first + length)


# Values of a channel


def _flipped(
    values: np.ndarray, strength: float, random: Random, signs: Sequence[float] = (-1.0,), offset: float = 0.0
) -> np.ndarray:
    return np.asarray(values * signs + offset)


def _scaled(values: np.ndarray, strength: float, random: Random) -> np.ndarray:
    return strength * values


def _shifted(values: np.ndarray, strength: float, random: Random) -> np.ndarray:
    return values + strength


def _shifted_either_way(values: np.ndarray, strength: float, random: Random) -> np.ndarray:
    return np.asarray(values + strength * random.choice((-1.0, 1.0)))


def _dead(values: np.ndarray, strength: float, random: Random) -> np.ndarray:
    return np.full_like(values, values[0])


def _clipped(values: np.ndarray, strength: float, random: Random) -> np.ndarray:
    limit = strength * np.percentile(np.abs(values), 99.5)
    return np.clip(values, -limit, limit)


def _coarse(values: np.ndarray, strength: float, random: Random) -> np.ndarray:
    step = strength * np.ptp(values)
    return np.asarray(np.round(values / step) * step)


def _noisy(values: np.ndarray, strength: float, random: Random) -> np.ndarray:
    return np.asarray(values + strength * values.std() * random.standard_normal(values.shape))


def _unrelated(values: np.ndarray, strength: float, random: Random) -> np.ndarray:
    knots = np.arange(0, len(values) + 50, 25)
    return np.interp(np.arange(len(values)), knots, random.uniform(-1, 1, len(knots)))[:, None]


def _spikes(values: np.ndarray, strength: float, random: Random) -> np.ndarray:
    rows = random.choice(len(values), int(strength), replace=False)
    span = np.ptp(values, axis=0) + 1e-3
    values[rows] += random.choice((-1.0, 1.0), (len(rows), 1)) * random.uniform(3, 20, (len(rows), 1)) * span
    return values


def _run(values: np.ndarray, strength: float, random: Random, value: float | None) -> np.ndarray:
    """A run of samples with one value; None holds its first."""
    rows = some_rows(len(values), int(strength), random)
    values[rows] = values[rows.start] if value is None else value
    return values


def _columns(values: np.ndarray, strength: float, random: Random, order: tuple[int, ...]) -> np.ndarray:
    return values[:, [*order[: values.shape[1]]]]


def _spread_out(values: np.ndarray, strength: float, random: Random) -> np.ndarray:
    return np.asarray(values[0] + strength * (values - values[0]))


def _single_precision(values: np.ndarray, strength: float, random: Random) -> np.ndarray:
    """UTM coordinates in single precision: northings in steps of 0.5 m."""
    away = np.array((412_000.0, 5_312_000.0, 0.0))[: values.shape[1]]
    return (values - values[0] + away).astype(np.float32).astype(np.float64)


def _ned(values: np.ndarray, strength: float, random: Random) -> np.ndarray:
    """A forward-right-down body in a north-east-down world; positions stay east-north-up."""
    world = Rotation.from_matrix(np.array(((0, 1, 0), (1, 0, 0), (0, 0, -1.0))))
    return (world * Rotation.from_quat(values) * Rotation.from_euler("x", np.pi)).as_quat()


def _tilted(values: np.ndarray, strength: float, random: Random) -> np.ndarray:
    """A sensor mounted with a roll, whose pose stands for the vehicle's."""
    return (Rotation.from_quat(values) * Rotation.from_euler("x", np.radians(strength))).as_quat()


def _signs(values: np.ndarray, strength: float, random: Random) -> np.ndarray:
    return values * random.choice((-1.0, 1.0), (len(values), 1))


_ONCE: Final = (1.0,)
_PEDALS: Final = ("throttle", "brake")
_HEADING: Final = ("orientation", "yaw")
_POSE: Final = ("position", *_HEADING)
_TURNS: Final = ("steer", "steer_angle", "yaw_rate", "linear_velocity", "angular_velocity")
_COURSE: Final = (*_TURNS, "controls")
_ALL: Final = (*_COURSE, *_PEDALS, "wheel_speed")
_SCALES: Final = (0.5, 0.7, 0.85, 1.2, 1.5, 2.0)
_RUNS: Final = (1.0, 5.0, 20.0, 100.0, 500.0)
_RUN_CHANNELS: Final = ("steer", "throttle", "steer_angle", "linear_velocity")

_OF_VALUES: Final[tuple[tuple[tuple[str, ...], str, Values, tuple[float, ...], str, bool], ...]] = (
    ((*_TURNS, *_PEDALS), "sign", _flipped, _ONCE, "", True),
    (("steer", "steer_angle"), "scale", _scaled, _SCALES, "times", True),
    (("linear_velocity",), "scale", _scaled, (0.7, 0.85, 0.95, 1.1, 1.3), "times", True),
    (("yaw_rate",), "scale", _scaled, (0.5, 0.8, 0.9, 1.1, 1.4), "times", True),
    (("throttle",), "scale", _scaled, (0.3, 0.5, 0.7), "times", True),
    (("steer",), "offset", _shifted_either_way, (0.02, 0.05, 0.1, 0.2, 0.4), "of full steering", True),
    (("steer_angle",), "offset", _shifted_either_way, (0.01, 0.03, 0.06, 0.12), "rad", True),
    (("yaw_rate",), "offset", _shifted_either_way, (0.01, 0.03, 0.1, 0.3), "rad/s", True),
    (("throttle",), "offset", _shifted, (0.05, 0.1, 0.2, 0.5), "of full throttle", True),
    (_PEDALS, "the wrong way round", partial(_flipped, offset=1.0), _ONCE, "", True),
    (("linear_velocity",), "x and y swapped", partial(_columns, order=(1, 0, 2)), _ONCE, "", True),
    (("angular_velocity",), "axes swapped", partial(_columns, order=(2, 0, 1)), _ONCE, "", True),
    (_RUN_CHANNELS, "huge values", partial(_run, value=1e10), _RUNS, "samples", False),
    (_RUN_CHANNELS, "zeros", partial(_run, value=0.0), _RUNS[2:], "samples", False),
    (_RUN_CHANNELS, "held", partial(_run, value=None), _RUNS[2:], "samples", False),
    (_RUN_CHANNELS, "NaN", partial(_run, value=np.nan), _RUNS, "samples", False),
    ((*_TURNS, *_PEDALS), "spikes", _spikes, (1.0, 3.0, 10.0, 30.0), "spikes", True),
    (("steer_angle", "wheel_speed", "brake_pressure", "yaw_rate", "steer", *_PEDALS), "dead", _dead, _ONCE, "", False),
    (("steer", "throttle", "steer_angle", "yaw_rate"), "clipped", _clipped, (0.8, 0.5, 0.3, 0.15),
     "of the largest value", False),
    (("steer", "steer_angle", "linear_velocity"), "coarse", _coarse, (0.05, 0.15, 0.3, 0.6), "of the span", False),
    (("steer",), "noise", _noisy, (0.05, 0.2, 0.5, 1.0), "of its spread", False),
    (("steer",), "something else", _unrelated, _ONCE, "", False),
    (("position",), "x and y only in float32", _single_precision, _ONCE, "", False),
)  # fmt: skip
"""Channels, name, change of the values, strengths, unit, fixable."""
_UNITS: Final = (
    ("steer_angle", "deg", 180 / np.pi), ("yaw_rate", "deg/s", 180 / np.pi), ("angular_velocity", "deg/s", 180 / np.pi),
    ("linear_velocity", "km/h", 3.6), ("linear_velocity", "mph", 2.23694), ("throttle", "percent", 100.0),
    ("brake", "percent", 100.0), ("engine_rpm", "rev/min", 1000.0), ("wheel_speed", "km/h", 3.6),
)  # fmt: skip
"""Channels, units that are not the rig's, and their factors."""


def _on(channel: str, values: Values) -> Change:
    """A change of one channel's values."""

    def change(case: Case, strength: float, random: Random) -> Case:
        return case.with_values(channel, values(case.values(channel), strength, random))

    return change


def _other_unit(case: Case, strength: float, random: Random, channel: str, unit: str) -> Case:
    """Another unit; one that the rig states is taken the other way."""
    stated = case.source(channel).unit
    return case.with_values(channel, case.values(channel) * (1 / strength if stated and stated in unit else strength))


def _wrapped(case: Case, strength: float, random: Random, channel: str) -> Case:
    """A 16-bit count in tenths that idles a little below zero and wraps there."""
    values = case.values(channel)
    counts = np.round(3000 * values - 150 + 40 * random.standard_normal(values.shape))
    entries = (("scale", 1 / 300), ("offset", 0.05), ("sign", 1), ("unit", ""))
    case = case.with_rig(*((f"channels.{channel}.{key}", value) for key, value in entries))
    return case.with_raw(channel, np.where(counts < 0, counts + 65536, counts) / 10)


def _pedals_swapped(case: Case, strength: float, random: Random) -> Case:
    throttle, brake = case.values("throttle"), case.values("brake")
    return case.with_values("throttle", brake).with_values("brake", throttle)


def _velocity_frame(case: Case, strength: float, random: Random) -> Case:
    body = case.source("linear_velocity").frame == "body"
    return case.with_rig(("channels.linear_velocity.frame", "world" if body else "body"))


def _world_rates(case: Case, strength: float, random: Random) -> Case:
    rates, pose = case.values("angular_velocity"), case.stream("orientation")
    at = np.clip(np.searchsorted(pose.time, case.stream("angular_velocity").time), 0, len(pose.time) - 1)
    rotation = rotation_from_quaternion(case.values("orientation"))[at]
    return case.with_values("angular_velocity", np.einsum("nij,nj->ni", rotation, rates))


def _late_copy(case: Case, strength: float, random: Random) -> Case:
    """A copy of the command whose lag changes between nothing and the strength."""
    time = case.stream("steer").time
    return _later(case, "steer", _wandering(time, strength, random, 5.0))


def _channel_faults() -> Iterator[Fault]:
    for channels, what, values, strengths, unit, fixable in _OF_VALUES:
        for channel in channels:
            consequences = ("controls",) if what in ("dead", "something else") else ()
            convention = (channel, what) == ("throttle", "scale")
            change = _on(channel, values)
            yield Fault(f"{channel}: {what}", "channel", strengths, unit, (channel,), change, consequences,
                        fixable=fixable, convention=convention)  # fmt: skip
    for channel, unit, factor in _UNITS:
        change = partial(_other_unit, channel=channel, unit=unit)
        yield Fault(f"{channel}: {unit}", "channel", (factor,), "times", (channel,), change, fixable=True)
    for channel in _PEDALS:
        change = partial(_wrapped, channel=channel)
        yield Fault(f"{channel}: 16-bit wrap", "channel", _ONCE, "", (channel,), change, fixable=True)
    yield Fault("throttle and brake swapped", "channel", _ONCE, "", _PEDALS, _pedals_swapped, fixable=True)
    velocity, rates = ("linear_velocity",), ("angular_velocity",)
    yield Fault("linear_velocity: frame", "channel", _ONCE, "", velocity, _velocity_frame, fixable=True)
    yield Fault("angular_velocity: world frame", "channel", _ONCE, "", rates, _world_rates,
                needs=(*rates, "orientation"))  # fmt: skip
    yield Fault("steer: late copy", "channel", (0.2, 0.5, 1.0), "s", ("steer",), _late_copy)


# Stamps and rows


def _wandering(time: np.ndarray, most: float, random: Random, period: float) -> np.ndarray:
    """Delays between nothing and `most` that change over a period [s]."""
    knots = np.arange(time[0] - 2 * period, time[-1] + 3 * period, period)
    return np.interp(time, knots, random.uniform(0, most, len(knots)))


def _later(case: Case, channel: str, late: np.ndarray | float) -> Case:
    """A channel whose values are those of an earlier time [s]."""
    time, values = case.stream(channel).time, case.values(channel)
    order = np.argsort(time, kind="stable")
    values = np.unwrap(values, axis=0) if channel == "yaw" else values
    values = same_sign(values) if channel == "orientation" else values
    moved = np.stack([np.interp(time - late, time[order], column[order]) for column in values.T], axis=1)
    if channel == "orientation":
        moved /= np.linalg.norm(moved, axis=1, keepdims=True)
    return case.with_values(channel, moved)


def _stamped_later(case: Case, channel: str, late: np.ndarray | float) -> Case:
    """A channel stamped later than it was measured [s], by its topic's stamps if nothing else uses them."""
    topic = case.source(channel).topic
    if [name for name, source in case.rig.channels.items() if source.topic == topic] == [channel]:
        return case.with_stamps(topic, case.streams[topic].time + late)
    return _later(case, channel, late)


def _delayed(case: Case, strength: float, random: Random, channels: tuple[str, ...]) -> Case:
    for channel in channels:
        if case.has(channel):
            case = _later(case, channel, strength) if channel in _POSE else _stamped_later(case, channel, strength)
    return case


def _drifting(case: Case, strength: float, random: Random) -> Case:
    time = case.stream("steer").time
    return _stamped_later(case, "steer", strength * (time - time[0]) / np.ptp(time))


def _bus_drifts(case: Case, strength: float, random: Random) -> Case:
    """Delays of all that the vehicle's bus carries, changing over half minutes."""
    pose = case.stream("position").time
    grid = np.arange(pose[0] - 60, pose[-1] + 60, 0.1)
    late = _wandering(grid, strength, random, 20.0)
    for topic, stream in case.streams.items():
        if topic not in (case.source("position").topic, "imu"):
            case = case.with_stamps(topic, stream.time + np.interp(stream.time, grid, late))
    return case


def _other_stamp_unit(case: Case, strength: float, random: Random) -> Case:
    for topic, stream in case.streams.items():
        case = case.with_stamps(topic, stream.time * strength)
    return case


def _clock_apart(case: Case, strength: float, random: Random) -> Case:
    """Headers by a clock that is slow; messages still arrive in time."""
    return case.with_stamps(case.source("steer").topic, case.stream("steer").time - strength)


def _shuffled(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    order = np.arange(len(time))
    moved = random.random(len(time)) < strength
    order[moved] = random.permutation(order[moved])
    return order


def _repeated(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    return np.repeat(np.arange(len(time)), 1 + (random.random(len(time)) < strength))


def _gaps(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    starts = random.uniform(time[0], time[-1] - 2, int(strength))
    return ~np.any((time >= starts[:, None]) & (time <= starts[:, None] + 2), axis=0)


def _lost(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    return np.asarray(random.random(len(time)) > strength)


def _truncated(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    return np.arange(len(time)) < (1 - strength) * len(time)


def _stamps_repeat(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    """Some samples with the stamp of the previous one."""
    again = random.random(len(time)) < strength
    again[0] = False
    return np.asarray(time[np.maximum.accumulate(np.where(again, 0, np.arange(len(time))))])


def _stamps_go_back(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    for row in random.choice(len(time), int(strength), replace=False):
        time[row:] -= random.uniform(0.1, 1.0)
    return time


def _no_stamps(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    time[some_rows(len(time), int(strength), random)] = np.nan
    return time


_OF_TOPICS: Final = (
    ("rows shuffled", _shuffled, True, (0.01, 0.1, 1.0), "of the rows"),
    ("rows repeated", _repeated, True, (0.05, 0.3, 0.6), "of the rows"),
    ("gaps", _gaps, True, (1.0, 3.0, 10.0), "of 2 s"),
    ("losses", _lost, True, (0.05, 0.2, 0.5), "of the samples"),
    ("truncated", _truncated, True, (0.1, 0.3, 0.6), "of the log"),
    ("stamps repeat", _stamps_repeat, False, (0.1, 0.3, 0.6), "of the stamps"),
    ("stamps go back", _stamps_go_back, False, (1.0, 3.0, 10.0), "times"),
    ("stamps not finite", _no_stamps, False, (1.0, 10.0, 100.0), "samples"),
)
"""Name, change of the stamps, whether it chooses rows instead, strengths, unit."""


def _of_topic(case: Case, strength: float, random: Random, channel: str, choose: Values, rows: bool) -> Case:
    topic = case.source(channel).topic
    chosen = choose(case.streams[topic].time.copy(), strength, random)
    return case.with_rows(topic, chosen) if rows else case.with_stamps(topic, chosen)


def _stamp_faults() -> Iterator[Fault]:
    delays = (-0.5, -0.2, -0.1, 0.1, 0.2, 0.5, 1.0)
    for channel in ("steer", "steer_angle", *_PEDALS, "linear_velocity", "yaw_rate", "wheel_speed"):
        change: Change = partial(_delayed, channels=(channel,))
        yield Fault(f"{channel}: delay", "stamps", delays, "s", (channel,), change, fixable=True)
    for name, channels, others in (("pose", _POSE, (*_TURNS, *_PEDALS, "wheel_speed")), ("heading", _HEADING, _TURNS)):
        change = partial(_delayed, channels=channels)
        yield Fault(f"{name}: delay", "stamps", delays, "s", channels, change, others, needs=(), fixable=True)
    yield Fault("steer: clock drifts", "stamps", (0.3, 0.6, 1.0, 2.0), "s over the log", ("steer",), _drifting)
    bus = ("wheel_speed", *_PEDALS, "steer")
    yield Fault("controls: clock drifts", "stamps", (0.5, 1.0, 2.0), "s", bus, _bus_drifts,
                ("steer_angle", "brake_pressure", "engine_rpm"), ("wheel_speed", "throttle", "topics"))  # fmt: skip
    for what, choose, rows, strengths, unit in _OF_TOPICS:
        for channel in ("position", "steer"):
            change = partial(_of_topic, channel=channel, choose=choose, rows=rows)
            # A table that ends early is a shorter log.
            needs = (channel, "topics") if what == "truncated" else (channel,)
            yield Fault(f"{channel}: {what}", "stamps", strengths, unit, (channel,), change, ("stamps",), needs)
    places = ("position", "steer", "throttle", "clock", "log")
    yield Fault("stamps in another unit", "stamps", (1e3, 1e6, 1e9), "times", places, _other_stamp_unit,
                ("stamps",), (), True)  # fmt: skip
    yield Fault("steer: header clock apart", "stamps", (0.6, 2.0, 30.0, 3600.0), "s", ("steer",), _clock_apart,
                _PEDALS, ("steer", "topics"), True)  # fmt: skip


# The pose


def _turned(case: Case, angle: np.ndarray | float) -> Case:
    """The case with its heading turned to the left by an angle, or by one per sample [rad]."""
    if case.has("yaw"):
        return case.with_values("yaw", case.values("yaw") + np.reshape(angle, (-1, 1)))
    quaternions = case.values("orientation")
    turn = Rotation.from_euler("z", np.broadcast_to(angle, len(quaternions))[:, None])
    return case.with_values("orientation", (turn * Rotation.from_quat(quaternions)).as_quat())


def _constant(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    return np.full(len(time), np.radians(strength) * random.choice((-1.0, 1.0)))


def _stepped(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    """Two steps, each returning later."""
    rows = np.sort(random.integers(len(time) // 10, 9 * len(time) // 10, 4))
    index = np.arange(len(time))
    there = (index >= rows[0]) & (index < rows[1])
    back = (index >= rows[2]) & (index < rows[3])
    return strength * (there.astype(float) - back)


def _glitching(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    """Ten single samples."""
    step = np.zeros(len(time))
    step[random.integers(0, len(time), 10)] = strength * random.choice((-1.0, 1.0), 10)
    return step


def _white(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    return strength * random.standard_normal(len(time))


def _growing(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    return strength * (time - time[0])


def _jumping(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    """Three corrections for good."""
    rows = random.integers(len(time) // 10, 9 * len(time) // 10, 3)
    return strength * random.choice((-1.0, 1.0), 3) @ (np.arange(len(time)) >= rows[:, None])


def _tail(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    """A position that runs away from four fifths of the log on."""
    return strength * np.maximum(time - time[0] - 0.8 * np.ptp(time), 0)


def _drift_of_heading(time: np.ndarray, strength: float, random: Random) -> np.ndarray:
    return np.radians(_growing(time, strength, random)) * random.choice((-1.0, 1.0))


_OF_HEADING: Final = (
    ("heading turned", _constant, (5.0, 10.0, 20.0, 45.0, 90.0, 180.0), "deg", True),
    ("heading: jumps", _stepped, (0.1, 0.3, 0.6, 1.5), "rad", False),
    ("heading: glitches", _glitching, (0.1, 0.3, 0.6, 1.5), "rad", False),
    ("heading: noise", _white, (0.01, 0.03, 0.1, 0.3), "rad", False),
    ("heading: drifts", _drift_of_heading, (0.1, 0.3, 1.0, 3.0), "deg/s", False),
)
"""Name, angle added to the heading [rad], strengths, unit, fixable."""
_OF_PLACES: Final[tuple[tuple[str, Values, tuple[int, ...], tuple[float, ...], str, tuple[str, ...]], ...]] = (
    ("jumps", _jumping, (0,), (0.1, 0.3, 1.0, 3.0, 10.0), "m", ()),
    ("glitches", _glitching, (0, 1), (0.1, 0.3, 1.0, 10.0), "m", ()),
    ("jumps of height", _jumping, (2,), (0.1, 0.3, 1.0, 5.0), "m", ()),
    ("height drifts", _growing, (2,), (0.01, 0.03, 0.1, 0.3), "m/s", ()),
    ("noise", _white, (0, 1, 2), (0.01, 0.03, 0.1, 0.3), "m", _ALL),
    ("a faster tail", _tail, (0,), (20.0, 100.0, 500.0), "m/s", _ALL),
)
"""Name, offset at a wheelbase of 2 m [m], axes, strengths, unit, consequences."""
_OF_POSE_VALUES: Final[tuple[tuple[str, str, Values, tuple[float, ...], str, tuple[str, ...], bool], ...]] = (
    ("position", "unit", _spread_out, (1000.0, 100.0, 3.28084), "times", _ALL, True),
    ("position", "z down", partial(_flipped, signs=(1, 1, -1)), _ONCE, "", (), True),
    ("position", "order of the columns", partial(_columns, order=(2, 0, 1)), _ONCE, "", (*_ALL, *_HEADING), True),
    ("position", "huge values", partial(_run, value=1e10), _RUNS, "samples", _ALL, False),
    ("position", "zeros", partial(_run, value=0.0), _RUNS, "samples", _ALL, False),
    ("position", "NaN", partial(_run, value=np.nan), _RUNS, "samples", _ALL, False),
    ("yaw", "sign", _flipped, _ONCE, "", _COURSE, True),
    ("yaw", "clockwise from north", partial(_flipped, offset=np.pi / 2), _ONCE, "", _COURSE, True),
    ("orientation", "order w x y z", partial(_columns, order=(3, 0, 1, 2)), _ONCE, "", _COURSE, True),
    ("orientation", "NED", _ned, _ONCE, "", _COURSE, False),
    ("orientation", "z not up", _tilted, (10.0, 30.0, 90.0), "deg", _COURSE, False),
    ("orientation", "inverse", partial(_flipped, signs=(-1, -1, -1, 1)), _ONCE, "", _COURSE, False),
)
"""Channel, name, change of the values, strengths, unit, consequences, fixable."""


def _turning(case: Case, strength: float, random: Random, angle: Values) -> Case:
    return _turned(case, angle(case.stream("position").time, strength, random))


def _moved(case: Case, strength: float, random: Random, offset: Values, axes: tuple[int, ...]) -> Case:
    """Positions moved along some axes, in proportion to the vehicle's size."""
    values, time = case.values("position"), case.stream("position").time
    for axis in axes[: values.shape[1]]:
        values[:, axis] += case.rig.vehicle.wheelbase / 2 * offset(time, strength, random)
    return case.with_values("position", values)


def _yaw_unit(case: Case, strength: float, random: Random) -> Case:
    factor = np.pi / 180 if case.source("yaw").unit == "deg" else 180 / np.pi
    return case.with_values("yaw", factor * case.values("yaw"))


def _frozen(case: Case, strength: float, random: Random, channels: tuple[str, ...]) -> Case:
    """Channels that four times stay as they are, and then continue."""
    time = case.stream("position").time
    for start in random.uniform(time[0], time[-1] - strength, 4):
        held = (time > start) & (time < start + strength)
        for channel in channels:
            if case.has(channel) and held.any():
                values = case.values(channel)
                values[held] = values[int(held.argmax())]
                case = case.with_values(channel, values)
    return case


def _pose_faults() -> Iterator[Fault]:
    height = ("position z",)
    for channel, what, values, strengths, unit, others, fixable in _OF_POSE_VALUES:
        yield Fault(f"{channel}: {what}", "pose", strengths, unit, (channel,), _on(channel, values), others,
                    height if what in ("order of the columns", "z down") else None, fixable)  # fmt: skip
    for what, offset, axes, strengths, unit, others in _OF_PLACES:
        yield Fault(f"position: {what}", "pose", strengths, f"{unit} at a wheelbase of 2 m", ("position",),
                    partial(_moved, offset=offset, axes=axes), others, height if axes == (2,) else None)  # fmt: skip
    for name, angle, strengths, unit, fixable in _OF_HEADING:
        change = partial(_turning, angle=angle)
        yield Fault(name, "pose", strengths, unit, _HEADING, change, _COURSE, (), fixable)
    for what, channels, strengths, others in (
        ("position", _POSE, (0.3, 1.0, 3.0, 10.0), _ALL), ("heading", _HEADING, (0.5, 2.0, 10.0), _COURSE)
    ):  # fmt: skip
        frozen = partial(_frozen, channels=channels)
        yield Fault(f"{what}: frozen", "pose", strengths, "s, four times", channels, frozen, others, ())
    swapped = _on("position", partial(_columns, order=(1, 0, 2)))
    yield Fault("position: x and y swapped", "pose", _ONCE, "", _POSE, swapped, _COURSE, (), True)
    yield Fault("yaw: unit", "pose", _ONCE, "", ("yaw",), _yaw_unit, _COURSE, fixable=True)


# The rig, and healthy changes


def _wheelbase(case: Case, strength: float, random: Random) -> Case:
    return case.with_rig(("vehicle.wheel_positions", [[strength * x, y] for x, y in case.rig.vehicle.wheel_positions]))


def _max_steer(case: Case, strength: float, random: Random) -> Case:
    return case.with_rig(("vehicle.max_steer", min(strength * case.rig.vehicle.max_steer, 1.5)))


def _delay(case: Case, strength: float, random: Random) -> Case:
    return case.with_rig(("channels.steer.delay", strength))


def _valid(case: Case, strength: float, random: Random) -> Case:
    """An interval that drops samples that are right."""
    low, high = np.percentile(case.values("steer"), (0, 100)).tolist()
    middle, half = (low + high) / 2, strength * (high - low) / 2
    return case.with_rig(("channels.steer.valid", [middle - half, middle + half]))


def _missing(case: Case, strength: float, random: Random) -> Case:
    return case.with_rig(("channels.wheel_speed.fields", [f"{name}_x" for name in case.source("wheel_speed").fields]))


def _mass(case: Case, strength: float, random: Random) -> Case:
    return case.with_rig(("vehicle.mass", strength * case.rig.vehicle.mass))


def _world_turned(case: Case, strength: float, random: Random) -> Case:
    """Positions, headings and velocities in a rotated world frame."""
    cos, sin = np.cos(strength), np.sin(strength)
    world = case.has("linear_velocity") and case.source("linear_velocity").frame == "world"
    for channel in ("position", *(("linear_velocity",) if world else ())):
        values = case.values(channel)
        values[:, :2] = values[:, :2] @ np.array(((cos, sin), (-sin, cos)))
        case = case.with_values(channel, values)
    return _turned(case, strength)


def _few_lost(case: Case, strength: float, random: Random) -> Case:
    for topic, stream in case.streams.items():
        count = len(stream.time)
        case = case.with_rows(topic, random.permutation(count) >= max(strength * count, 1))
    return case


def _unused(case: Case, strength: float, random: Random) -> Case:
    """Garbage that the rig does not read."""
    stream = case.stream("position")
    columns = {"garbage": random.standard_cauchy(len(stream.time)), "dead": np.zeros(len(stream.time))}
    if "" in case.streams:
        return case.with_stream("", replace(stream, columns=stream.columns | columns))
    return case.with_stream("debug", replace(stream, columns=columns))


def _rig_faults() -> Iterator[Fault]:
    factors, steering = (0.25, 0.5, 0.75, 1.33, 2.0, 4.0), ("steer",)
    rows: tuple[tuple[Any, ...], ...] = (
        ("wrong wheelbase", factors, "times", (*steering, "steer_angle", "vehicle"), _wheelbase, steering),
        ("wrong max_steer", factors, "times", (*steering, "vehicle"), _max_steer, None),
        ("wrong delay in the rig", (-0.5, -0.2, 0.2, 0.5), "s", steering, _delay, None),
        ("wrong valid interval", (0.9, 0.6, 0.3), "of the span", steering, _valid, None),
        ("channel missing in the log", _ONCE, "", ("wheel_speed", "log"), _missing, ("wheel_speed",)),
    )
    for name, strengths, unit, places, change, needs in rows:
        yield Fault(name, "rig", strengths, unit, places, change, needs=needs, fixable=True)
    healthy: tuple[tuple[Any, ...], ...] = (
        ("wrong mass", (0.5, 2.0), "times", _mass, ()),
        ("world turned", (0.5, 2.5), "rad", _world_turned, ()),
        ("quaternions of the other sign", _ONCE, "", _on("orientation", _signs), ("orientation",)),
        ("a few samples lost", (0.002, 0.01), "of the samples", _few_lost, ()),
        ("unused topics", _ONCE, "", _unused, ()),
    )
    for name, strengths, unit, change, needs in healthy:
        yield Fault(name, "healthy", strengths, unit, (), change, needs=needs)


FAULTS: Final = {
    fault.name: fault
    for faults in (_channel_faults(), _stamp_faults(), _pose_faults(), _rig_faults())
    for fault in faults
}
"""All faults by name."""
