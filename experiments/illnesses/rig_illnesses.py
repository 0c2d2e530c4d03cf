"""Illnesses of the rig alone, and changes that are no illness and must raise nothing."""

from typing import Final

import numpy as np

from experiments.illnesses.illness import illness
from experiments.illnesses.recording import Case

_STEERING: Final = ("steer", "steer_angle")
_FACTORS: Final = (0.25, 0.5, 0.75, 1.33, 2.0, 4.0)


@illness("wrong wheelbase", "rig", _FACTORS, "times", (*_STEERING, "vehicle"), needs=("steer",), curable=True)
def _wheelbase(case: Case, strength: float, random: np.random.Generator) -> Case:
    places = [[strength * x, y] for x, y in case.rig.vehicle.wheel_positions]
    return case.with_rig(("vehicle.wheel_positions", places))


@illness("wrong max_steer", "rig", _FACTORS, "times", ("steer", "vehicle"), curable=True)
def _max_steer(case: Case, strength: float, random: np.random.Generator) -> Case:
    return case.with_rig(("vehicle.max_steer", min(strength * case.rig.vehicle.max_steer, 1.5)))


@illness("wrong delay in the rig", "rig", (-0.5, -0.2, 0.2, 0.5), "s", ("steer",), curable=True)
def _delay(case: Case, strength: float, random: np.random.Generator) -> Case:
    return case.with_rig(("channels.steer.delay", strength))


@illness("wrong valid interval", "rig", (0.9, 0.6, 0.3), "of the span", ("steer",), curable=True)
def _valid(case: Case, strength: float, random: np.random.Generator) -> Case:
    """An interval that drops samples that are right."""
    low, high = np.percentile(case.values("steer"), (0, 100)).tolist()
    middle, half = (low + high) / 2, (high - low) / 2
    return case.with_rig(("channels.steer.valid", [middle - strength * half, middle + strength * half]))


@illness("channel missing in the log", "rig", (1.0,), "", ("wheel_speed", "log"), needs=("wheel_speed",), curable=True)
def _missing(case: Case, strength: float, random: np.random.Generator) -> Case:
    fields = [f"{field}_x" for field in case.source("wheel_speed").fields]
    return case.with_rig(("channels.wheel_speed.fields", fields))


@illness("wrong mass", "healthy", (0.5, 2.0), "times", (), needs=())
def _mass(case: Case, strength: float, random: np.random.Generator) -> Case:
    return case.with_rig(("vehicle.mass", strength * case.rig.vehicle.mass))


@illness("world turned", "healthy", (0.5, 2.5), "rad", (), needs=())
def _world_turned(case: Case, strength: float, random: np.random.Generator) -> Case:
    """Positions, headings and velocities in a world frame that is turned: no frame is better than another."""
    cos, sin = np.cos(strength), np.sin(strength)
    turn = np.array(((cos, sin), (-sin, cos)))
    world = case.has("linear_velocity") and case.source("linear_velocity").frame == "world"
    for channel in ("position", *(("linear_velocity",) if world else ())):
        values = case.values(channel)
        values[:, :2] = values[:, :2] @ turn
        case = case.with_values(channel, values)
    if case.has("yaw"):
        return case.with_values("yaw", case.values("yaw") + strength)
    x, y, z, w = case.values("orientation").T
    half_cos, half_sin = np.cos(strength / 2), np.sin(strength / 2)
    product = (half_cos * x - half_sin * y, half_cos * y + half_sin * x, half_cos * z + half_sin * w,
               half_cos * w - half_sin * z)  # fmt: skip
    return case.with_values("orientation", np.stack(product, axis=1))


@illness("quaternions of the other sign", "healthy", (1.0,), "", (), needs=("orientation",))
def _other_sign(case: Case, strength: float, random: np.random.Generator) -> Case:
    """Q and -q are the same rotation; some filters jump between them."""
    signs = random.choice((-1.0, 1.0), (len(case.values("orientation")), 1))
    return case.with_values("orientation", signs * case.values("orientation"))


@illness("a few samples lost", "healthy", (0.002, 0.01), "of the samples", (), needs=())
def _few_lost(case: Case, strength: float, random: np.random.Generator) -> Case:
    for topic in case.streams:
        case = case.with_rows(topic, lambda count: random.permutation(count) >= max(strength * count, 1))
    return case


@illness("unused topics", "healthy", (1.0,), "", (), needs=())
def _unused(case: Case, strength: float, random: np.random.Generator) -> Case:
    """A topic of garbage that the rig does not read."""
    stream = case.stream("position")
    columns = {"garbage": random.standard_cauchy(len(stream.time)), "dead": np.zeros(len(stream.time))}
    if "" in case.streams:
        return case.with_stream("", type(stream)(stream.time, stream.arrival, stream.columns | columns))
    return case.with_stream("debug", type(stream)(stream.time, stream.arrival, columns))
