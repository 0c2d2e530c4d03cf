"""Illnesses of positions and headings: axes, units, jumps, noise, freezing."""

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.illnesses.illness import illness, some_rows
from experiments.illnesses.recording import Case

_ONCE: Final = (1.0,)
_HEADING: Final = ("orientation", "yaw")
_TURNS: Final = ("steer", "steer_angle", "yaw_rate", "angular_velocity", "linear_velocity", "controls")
_ALL: Final = (*_TURNS, "throttle", "brake", "wheel_speed")


def turned(case: Case, angle: np.ndarray | float) -> Case:
    """The case with its heading turned to the left by an angle, one or one a sample [rad]."""
    if case.has("yaw"):
        return case.with_values("yaw", case.values("yaw") + np.reshape(angle, (-1, 1)))
    turn = Rotation.from_euler("z", np.broadcast_to(angle, len(case.values("orientation")))[:, None])
    return case.with_values("orientation", (turn * Rotation.from_quat(case.values("orientation"))).as_quat())


def moved(case: Case, offset: np.ndarray) -> Case:
    """The case with positions moved by offsets, one a sample and coordinate [m]."""
    values = case.values("position")
    return case.with_values("position", values + offset[:, : values.shape[1]])


@illness("position: unit", "pose", (1000.0, 100.0, 3.28084), "times", ("position",), curable=True, consequences=_ALL)
def _unit(case: Case, strength: float, random: np.random.Generator) -> Case:
    values = case.values("position")
    return case.with_values("position", values[0] + strength * (values - values[0]))


@illness("position: x and y swapped", "pose", _ONCE, "", ("position", *_HEADING), needs=(), curable=True,
         consequences=_TURNS)  # fmt: skip
def _swapped(case: Case, strength: float, random: np.random.Generator) -> Case:
    values = case.values("position")
    return case.with_values("position", np.column_stack((values[:, 1], values[:, 0], values[:, 2:])))


@illness("position: order of the columns", "pose", _ONCE, "", ("position",), needs=("position z",), curable=True,
         consequences=(*_ALL, *_HEADING))  # fmt: skip
def _order(case: Case, strength: float, random: np.random.Generator) -> Case:
    return case.with_values("position", np.roll(case.values("position"), 1, axis=1))


@illness("position: z down", "pose", _ONCE, "", ("position",), needs=("position z",), curable=True)
def _z_down(case: Case, strength: float, random: np.random.Generator) -> Case:
    return case.with_values("position", case.values("position") * (1, 1, -1))


@illness("yaw: sign", "pose", _ONCE, "", ("yaw",), curable=True, consequences=_TURNS)
def _yaw_sign(case: Case, strength: float, random: np.random.Generator) -> Case:
    return case.scaled("yaw", -1.0)


@illness("yaw: unit", "pose", _ONCE, "", ("yaw",), curable=True, consequences=_TURNS)
def _yaw_unit(case: Case, strength: float, random: np.random.Generator) -> Case:
    stated = case.source("yaw").unit == "deg"
    return case.scaled("yaw", np.pi / 180 if stated else 180 / np.pi)


@illness("yaw: clockwise from north", "pose", _ONCE, "", ("yaw",), curable=True, consequences=_TURNS)
def _compass(case: Case, strength: float, random: np.random.Generator) -> Case:
    return case.with_values("yaw", np.pi / 2 - case.values("yaw"))


@illness("heading turned", "pose", (5.0, 10.0, 20.0, 45.0, 90.0, 180.0), "deg", _HEADING, needs=(), curable=True,
         consequences=_TURNS)  # fmt: skip
def _turned(case: Case, strength: float, random: np.random.Generator) -> Case:
    return turned(case, np.radians(strength) * random.choice((-1.0, 1.0)))


@illness("orientation: order w x y z", "pose", _ONCE, "", ("orientation",), curable=True, consequences=_TURNS)
def _wxyz(case: Case, strength: float, random: np.random.Generator) -> Case:
    return case.with_values("orientation", np.roll(case.values("orientation"), 1, axis=1))


@illness("orientation: NED", "pose", _ONCE, "", ("orientation",), consequences=_TURNS)
def _ned(case: Case, strength: float, random: np.random.Generator) -> Case:
    """A forward-right-down body in a north-east-down world; positions stay east-north-up."""
    world = Rotation.from_matrix(np.array(((0, 1, 0), (1, 0, 0), (0, 0, -1.0))))
    body = Rotation.from_euler("x", np.pi)
    return case.with_values("orientation", (world * Rotation.from_quat(case.values("orientation")) * body).as_quat())


@illness("orientation: z not up", "pose", (10.0, 30.0, 90.0), "deg", ("orientation",), consequences=_TURNS)
def _tilted(case: Case, strength: float, random: np.random.Generator) -> Case:
    """A sensor that is mounted with a roll, whose pose stands for the vehicle's."""
    mounting = Rotation.from_euler("x", np.radians(strength))
    return case.with_values("orientation", (Rotation.from_quat(case.values("orientation")) * mounting).as_quat())


@illness("orientation: inverse", "pose", _ONCE, "", ("orientation",), consequences=_TURNS)
def _inverse(case: Case, strength: float, random: np.random.Generator) -> Case:
    """body_from_world in place of world_from_body."""
    return case.with_values("orientation", case.values("orientation") * (-1, -1, -1, 1))


def _size(case: Case) -> float:
    """Wheelbase over two metres, so that jumps fit the vehicle."""
    return case.rig.vehicle.wheelbase / 2


@illness("position: jumps", "pose", (0.1, 0.3, 1.0, 3.0, 10.0), "m at a wheelbase of 2 m", ("position",))
def _jumps(case: Case, strength: float, random: np.random.Generator) -> Case:
    """Three corrections for good."""
    count = len(case.values("position"))
    offset = np.zeros((count, 3))
    for row in random.integers(count // 10, 9 * count // 10, 3):
        direction = random.uniform(-np.pi, np.pi)
        offset[row:, :2] += strength * _size(case) * np.array((np.cos(direction), np.sin(direction)))
    return moved(case, offset)


@illness("position: glitches", "pose", (0.1, 0.3, 1.0, 10.0), "m at a wheelbase of 2 m", ("position",))
def _glitches(case: Case, strength: float, random: np.random.Generator) -> Case:
    """Ten samples beside the path."""
    count = len(case.values("position"))
    offset = np.zeros((count, 3))
    offset[random.integers(0, count, 10), :2] = strength * _size(case) * random.choice((-1.0, 1.0), (10, 2))
    return moved(case, offset)


@illness(
    "position: jumps of height",
    "pose",
    (0.1, 0.3, 1.0, 5.0),
    "m at a wheelbase of 2 m",
    ("position",),
    needs=("position z",),
)
def _steps(case: Case, strength: float, random: np.random.Generator) -> Case:
    count = len(case.values("position"))
    offset = np.zeros((count, 3))
    for row in random.integers(count // 10, 9 * count // 10, 3):
        offset[row:, 2] += strength * _size(case) * random.choice((-1.0, 1.0))
    return moved(case, offset)


@illness(
    "position: height drifts",
    "pose",
    (0.01, 0.03, 0.1, 0.3),
    "m/s at a wheelbase of 2 m",
    ("position",),
    needs=("position z",),
)
def _drifts(case: Case, strength: float, random: np.random.Generator) -> Case:
    time = case.stream("position").time
    offset = np.zeros((len(time), 3))
    offset[:, 2] = strength * _size(case) * (time - time[0])
    return moved(case, offset)


@illness("position: noise", "pose", (0.01, 0.03, 0.1, 0.3), "m at a wheelbase of 2 m", ("position",), consequences=_ALL)
def _noise(case: Case, strength: float, random: np.random.Generator) -> Case:
    return moved(case, strength * _size(case) * random.standard_normal((len(case.values("position")), 3)))


@illness("position: frozen", "pose", (0.3, 1.0, 3.0, 10.0), "s, four times", ("position", *_HEADING), needs=(),
         consequences=_ALL)  # fmt: skip
def _frozen(case: Case, strength: float, random: np.random.Generator) -> Case:
    """The whole pose stays where it was, and then continues."""
    time = case.stream("position").time
    for start in random.uniform(time[0], time[-1] - strength, 4):
        held = (time > start) & (time < start + strength)
        if not held.any():
            continue
        for channel in ("position", *_HEADING):
            if case.has(channel):
                values = case.values(channel)
                values[held] = values[int(held.argmax())]
                case = case.with_values(channel, values)
    return case


@illness("position: a faster tail", "pose", (20.0, 100.0, 500.0), "m/s", ("position",), consequences=_ALL)
def _tail(case: Case, strength: float, random: np.random.Generator) -> Case:
    """From four fifths of the log on the positions run away."""
    time = case.stream("position").time
    offset = np.zeros((len(time), 3))
    offset[:, 0] = strength * np.maximum(time - time[0] - 0.8 * np.ptp(time), 0)
    return moved(case, offset)


def _declare_run(name: str, value: float) -> None:
    @illness(f"position: {name}", "pose", (1.0, 5.0, 50.0, 500.0), "samples", ("position",), consequences=_ALL)
    def _change(case: Case, strength: float, random: np.random.Generator) -> Case:
        values = case.values("position")
        values[some_rows(len(values), int(strength), random)] = value
        return case.with_values("position", values)


for _name, _value in (("huge values", 1e10), ("zeros", 0.0), ("NaN", np.nan)):
    _declare_run(_name, _value)


@illness("heading: jumps", "pose", (0.1, 0.3, 0.6, 1.5), "rad", _HEADING, needs=(), consequences=_TURNS)
def _heading_jumps(case: Case, strength: float, random: np.random.Generator) -> Case:
    """Three steps within a sample that the heading returns from later."""
    count = len(case.stream("position").time)
    rows = np.sort(random.integers(count // 10, 9 * count // 10, 4))
    step = np.zeros(count)
    step[rows[0] : rows[1]] = strength
    step[rows[2] : rows[3]] = -strength
    return turned(case, step)


@illness("heading: glitches", "pose", (0.1, 0.3, 0.6, 1.5), "rad", _HEADING, needs=(), consequences=_TURNS)
def _heading_glitches(case: Case, strength: float, random: np.random.Generator) -> Case:
    """Ten single samples that point elsewhere."""
    count = len(case.stream("position").time)
    step = np.zeros(count)
    step[random.integers(0, count, 10)] = strength * random.choice((-1.0, 1.0), 10)
    return turned(case, step)


@illness("heading: noise", "pose", (0.01, 0.03, 0.1, 0.3), "rad", _HEADING, needs=(), consequences=_TURNS)
def _heading_noise(case: Case, strength: float, random: np.random.Generator) -> Case:
    return turned(case, strength * random.standard_normal(len(case.stream("position").time)))


@illness("heading: drifts", "pose", (0.1, 0.3, 1.0, 3.0), "deg/s", _HEADING, needs=(), consequences=_TURNS)
def _heading_drifts(case: Case, strength: float, random: np.random.Generator) -> Case:
    time = case.stream("position").time
    return turned(case, np.radians(strength) * (time - time[0]) * random.choice((-1.0, 1.0)))


@illness("heading: frozen", "pose", (0.5, 2.0, 10.0), "s, four times", _HEADING, needs=(), consequences=_TURNS)
def _heading_frozen(case: Case, strength: float, random: np.random.Generator) -> Case:
    channel = "yaw" if case.has("yaw") else "orientation"
    time, values = case.stream(channel).time, case.values(channel)
    for start in random.uniform(time[0], time[-1] - strength, 4):
        held = (time > start) & (time < start + strength)
        values[held] = values[int(held.argmax())]
    return case.with_values(channel, values)
