"""Illnesses of the numbers in one channel: signs, units, offsets, faulty samples, noise."""

from typing import Final

import numpy as np

from experiments.illnesses.illness import illness, some_rows
from experiments.illnesses.recording import Case
from offpiste.core.geometry import rotation_from_quaternion

_ONCE: Final = (1.0,)
_CONTROLS: Final = ("throttle", "brake")
_TURNS: Final = ("steer", "steer_angle", "yaw_rate", "linear_velocity", "angular_velocity")


def _declare_sign(channel: str) -> None:
    @illness(f"{channel}: sign", "channel", _ONCE, "", (channel,), curable=True)
    def _change(case: Case, strength: float, random: np.random.Generator) -> Case:
        return case.scaled(channel, -1.0)


for _channel in ("steer", "steer_angle", "yaw_rate", "linear_velocity", "angular_velocity", *_CONTROLS):
    _declare_sign(_channel)


def _declare_unit(channel: str, name: str, factors: tuple[float, ...], unit: str) -> None:
    """A unit that is not the rig's; one that the rig states already is taken the other way."""
    # What full throttle is, nothing says but its own range: a steering is held to an angle, a velocity to the path.
    convention = (channel, name) == ("throttle", "scale")

    @illness(f"{channel}: {name}", "channel", factors, unit, (channel,), curable=True, convention=convention)
    def _change(case: Case, strength: float, random: np.random.Generator) -> Case:
        stated = case.source(channel).unit
        return case.scaled(channel, 1 / strength if stated and stated in name else strength)


_DEGREES: Final = 180 / np.pi
_SCALES: Final[tuple[tuple[str, str, tuple[float, ...]], ...]] = (
    ("steer_angle", "deg", (_DEGREES,)),
    ("yaw_rate", "deg/s", (_DEGREES,)),
    ("angular_velocity", "deg/s", (_DEGREES,)),
    ("linear_velocity", "km/h", (3.6,)),
    ("linear_velocity", "mph", (2.23694,)),
    ("throttle", "percent", (100.0,)),
    ("brake", "percent", (100.0,)),
    ("engine_rpm", "rev/min", (1000.0,)),
    ("wheel_speed", "km/h", (3.6,)),
    ("steer", "scale", (0.5, 0.7, 0.85, 1.2, 1.5, 2.0)),
    ("steer_angle", "scale", (0.5, 0.7, 0.85, 1.2, 1.5, 2.0)),
    ("linear_velocity", "scale", (0.7, 0.85, 0.95, 1.1, 1.3)),
    ("yaw_rate", "scale", (0.5, 0.8, 0.9, 1.1, 1.4)),
    ("throttle", "scale", (0.3, 0.5, 0.7)),
)
for _channel, _name, _factors in _SCALES:
    _declare_unit(_channel, _name, _factors, "times")


def _declare_offset(channel: str, offsets: tuple[float, ...], unit: str) -> None:
    @illness(f"{channel}: offset", "channel", offsets, unit, (channel,), curable=True)
    def _change(case: Case, strength: float, random: np.random.Generator) -> Case:
        return case.with_values(channel, case.values(channel) + strength * random.choice((-1.0, 1.0)))


_declare_offset("steer", (0.02, 0.05, 0.1, 0.2, 0.4), "of full steering")
_declare_offset("steer_angle", (0.01, 0.03, 0.06, 0.12), "rad")
_declare_offset("yaw_rate", (0.01, 0.03, 0.1, 0.3), "rad/s")


@illness("throttle: offset", "channel", (0.05, 0.1, 0.2, 0.5), "of full throttle", ("throttle",), curable=True)
def _throttle_offset(case: Case, strength: float, random: np.random.Generator) -> Case:
    return case.with_values("throttle", case.values("throttle") + strength)


def _declare_reversed(channel: str) -> None:
    @illness(f"{channel}: the wrong way round", "channel", _ONCE, "", (channel,), curable=True)
    def _change(case: Case, strength: float, random: np.random.Generator) -> Case:
        return case.with_values(channel, 1 - case.values(channel))


for _channel in _CONTROLS:
    _declare_reversed(_channel)


@illness("throttle and brake swapped", "channel", _ONCE, "", _CONTROLS, curable=True)
def _pedals_swapped(case: Case, strength: float, random: np.random.Generator) -> Case:
    throttle, brake = case.values("throttle"), case.values("brake")
    return case.with_values("throttle", brake).with_values("brake", throttle)


@illness("linear_velocity: frame", "channel", _ONCE, "", ("linear_velocity",), curable=True)
def _frame(case: Case, strength: float, random: np.random.Generator) -> Case:
    frame = case.source("linear_velocity").frame
    return case.with_rig(("channels.linear_velocity.frame", "world" if frame == "body" else "body"))


@illness("linear_velocity: x and y swapped", "channel", _ONCE, "", ("linear_velocity",), curable=True)
def _velocity_swapped(case: Case, strength: float, random: np.random.Generator) -> Case:
    values = case.values("linear_velocity")
    values[:, :2] = values[:, 1::-1].copy()
    return case.with_values("linear_velocity", values)


@illness("angular_velocity: axes swapped", "channel", _ONCE, "", ("angular_velocity",), curable=True)
def _rates_swapped(case: Case, strength: float, random: np.random.Generator) -> Case:
    return case.with_values("angular_velocity", np.roll(case.values("angular_velocity"), 1, axis=1))


@illness(
    "angular_velocity: world frame",
    "channel",
    _ONCE,
    "",
    ("angular_velocity",),
    needs=("angular_velocity", "orientation"),
)
def _world_rates(case: Case, strength: float, random: np.random.Generator) -> Case:
    rates, pose = case.values("angular_velocity"), case.stream("orientation")
    at = np.clip(np.searchsorted(pose.time, case.stream("angular_velocity").time), 0, len(pose.time) - 1)
    rotation = rotation_from_quaternion(case.values("orientation"))[at]
    return case.with_values("angular_velocity", np.einsum("nij,nj->ni", rotation, rates))


def _declare_faulty(channel: str) -> None:
    """Runs of samples that hold something else than the measurement."""

    def faulty(case: Case, strength: float, random: np.random.Generator, value: float | None) -> Case:
        values = case.values(channel)
        rows = some_rows(len(values), int(strength), random)
        values[rows] = values[rows.start] if value is None else value
        return case.with_values(channel, values)

    lengths = (1.0, 5.0, 20.0, 100.0, 500.0)
    for name, value, strengths in (
        ("huge values", 1e10, lengths),
        ("zeros", 0.0, lengths[2:]),
        ("held", None, lengths[2:]),
        ("NaN", np.nan, lengths),
    ):

        @illness(f"{channel}: {name}", "channel", strengths, "samples", (channel,))
        def _change(case: Case, strength: float, random: np.random.Generator, value: float | None = value) -> Case:
            return faulty(case, strength, random, value)


for _channel in ("steer", "throttle", "steer_angle", "linear_velocity"):
    _declare_faulty(_channel)


def _declare_spikes(channel: str) -> None:
    @illness(f"{channel}: spikes", "channel", (1.0, 3.0, 10.0, 30.0), "spikes", (channel,), curable=True)
    def _change(case: Case, strength: float, random: np.random.Generator) -> Case:
        values = case.values(channel)
        rows = random.choice(len(values), int(strength), replace=False)
        span = np.ptp(values, axis=0) + 1e-3
        values[rows] += random.choice((-1.0, 1.0), (len(rows), 1)) * random.uniform(3, 20, (len(rows), 1)) * span
        return case.with_values(channel, values)


for _channel in (*_TURNS, *_CONTROLS):
    _declare_spikes(_channel)


def _declare_wrapped(channel: str) -> None:
    @illness(f"{channel}: 16-bit wrap", "channel", _ONCE, "", (channel,), curable=True)
    def _change(case: Case, strength: float, random: np.random.Generator) -> Case:
        """A count in tenths that idles a little below zero and wraps there."""
        values = case.values(channel)
        counts = np.round(3000 * values - 150 + 40 * random.standard_normal(values.shape))
        wrapped = np.where(counts < 0, counts + 65536, counts) / 10
        entries = (("scale", 1 / 300), ("offset", 0.05), ("sign", 1), ("unit", ""))
        case = case.with_rig(*((f"channels.{channel}.{key}", value) for key, value in entries))
        return case.with_raw(channel, wrapped)


for _channel in _CONTROLS:
    _declare_wrapped(_channel)


def _declare_dead(channel: str) -> None:
    @illness(f"{channel}: dead", "channel", _ONCE, "", (channel,), consequences=("controls",))
    def _change(case: Case, strength: float, random: np.random.Generator) -> Case:
        values = case.values(channel)
        return case.with_values(channel, np.full_like(values, values[0]))


for _channel in (*_CONTROLS, "steer", "steer_angle", "wheel_speed", "brake_pressure", "yaw_rate"):
    _declare_dead(_channel)


def _declare_clipped(channel: str) -> None:
    @illness(f"{channel}: clipped", "channel", (0.8, 0.5, 0.3, 0.15), "of the largest value", (channel,))
    def _change(case: Case, strength: float, random: np.random.Generator) -> Case:
        values = case.values(channel)
        limit = strength * np.percentile(np.abs(values), 99.5)
        return case.with_values(channel, np.clip(values, -limit, limit))


for _channel in ("steer", "throttle", "steer_angle", "yaw_rate"):
    _declare_clipped(_channel)


def _declare_coarse(channel: str) -> None:
    @illness(f"{channel}: coarse", "channel", (0.05, 0.15, 0.3, 0.6), "of the span", (channel,))
    def _change(case: Case, strength: float, random: np.random.Generator) -> Case:
        values = case.values(channel)
        step = strength * np.ptp(values)
        return case.with_values(channel, np.round(values / step) * step)


for _channel in ("steer", "steer_angle", "linear_velocity"):
    _declare_coarse(_channel)


@illness("steer: noise", "channel", (0.05, 0.2, 0.5, 1.0), "of its spread", ("steer",))
def _steer_noise(case: Case, strength: float, random: np.random.Generator) -> Case:
    values = case.values("steer")
    return case.with_values("steer", values + strength * values.std() * random.standard_normal(values.shape))


@illness("steer: something else", "channel", _ONCE, "", ("steer",), consequences=("controls",))
def _unrelated(case: Case, strength: float, random: np.random.Generator) -> Case:
    values = case.values("steer")
    knots = np.arange(0, len(values) + 50, 25)
    other = np.interp(np.arange(len(values)), knots, random.uniform(-1, 1, len(knots)))
    return case.with_values("steer", other[:, None])


@illness("steer: late copy", "channel", (0.2, 0.5, 1.0), "s", ("steer",))
def _late_copy(case: Case, strength: float, random: np.random.Generator) -> Case:
    """A copy of the command whose lag changes between nothing and the strength."""
    time, values = case.stream("steer").time, case.values("steer")[:, 0]
    knots = np.arange(time[0] - 5, time[-1] + 10, 5.0)
    lag = np.interp(time, knots, random.uniform(0, strength, len(knots)))
    return case.with_values("steer", np.interp(time - lag, time, values)[:, None])


@illness("position: x and y only in float32", "channel", _ONCE, "", ("position",))
def _single_precision(case: Case, strength: float, random: np.random.Generator) -> Case:
    """UTM coordinates in single precision: northings in steps of 0.5 m."""
    values = case.values("position")
    away = np.zeros(values.shape[1])
    away[:2] = 412_000.0, 5_312_000.0
    shifted = values - values[0] + away
    return case.with_values("position", shifted.astype(np.float32).astype(np.float64))
