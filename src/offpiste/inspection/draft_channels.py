"""Channels of a draft rig: selected guesses, with units, scales and signs inferred from names and values."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from offpiste.inspection.commanded_motion import motion_settings
from offpiste.inspection.draft_controls import (
    PEDALS,
    Scalar,
    draft_steering,
    pedal_settings,
    signed_pedal,
)
from offpiste.inspection.draft_pose import POSE_CHANNELS, Entry, draft_pose, unit_setting
from offpiste.inspection.gear import MOST_GEARS, gear_values
from offpiste.inspection.missing import no_pose
from offpiste.inspection.naming import ACCELERATOR, MEASURED, MOTION, Guess, field_values
from offpiste.logs.log import Log
from offpiste.rig.labels import is_array_entry


@dataclass(frozen=True)
class Facts:
    """Facts from reading the log through an incomplete rig.

    Attributes:
        frame: of the linear velocity.
        wheelbase: [m], or 0.
        max_steer: road wheel angle at a steering command of 1 for this wheelbase [rad], or 0.
        assumed: True if the wheelbase is chosen to match a usual `max_steer`.
        straight: recorded steering in straight driving; None if its centre is not guessed.
        backwards: True if negative pedal values drive backwards.
    """

    frame: str = "unknown"
    wheelbase: float = 0.0
    max_steer: float = 0.0
    assumed: bool = False
    straight: float | None = None
    backwards: bool = False


def draft_channels(log: Log, guesses: Sequence[Guess], facts: Facts) -> dict[str, Entry]:
    """Return entries by channel, the pose's first; the first guess of a channel with valid values is used.

    Raises:
        LogError: no pose was found, or its samples cannot be read.
    """
    entries = draft_pose(log, guesses, facts.frame)
    if "position" not in entries or not {"orientation", "yaw"} & set(entries):
        raise no_pose(log)
    scalars = _scalars(log, guesses, entries)
    if "brake" not in scalars and "brake_pressure" in scalars:
        scalars["brake"] = scalars.pop("brake_pressure")  # used as the command
    if "steer" not in scalars and "steer_angle" in scalars and scalars["steer_angle"].guess.rank == MEASURED:
        angle = scalars.pop("steer_angle")
        # Without a command, a position of any unit is the steering; a joint's position is an angle.
        scalars["steer"] = angle if is_array_entry(angle.guess.fields[0]) else angle.of(channel="steer")
    steering = draft_steering(scalars, facts.straight, facts.max_steer)
    others = {name: _entry(name, scalar) for name, scalar in scalars.items() if name not in ("steer", "steer_angle")}
    return entries | others | signed_pedal(scalars, backwards=facts.backwards) | steering


def _scalars(log: Log, guesses: Sequence[Guess], pose: Mapping[str, Entry]) -> dict[str, Scalar]:
    """Return the first guess of each scalar channel whose values vary and do not contradict the name."""
    unused = {*POSE_CHANNELS, *(["yaw_rate"] if "angular_velocity" in pose else [])}
    scalars: dict[str, Scalar] = {}
    for guess in guesses:
        commanded = guess.channel == "steer_angle" and guess.rank < MEASURED and guess.is_command
        channel = "steer" if commanded else guess.channel
        vague = channel == "wheel_speed" and guess.rank > 1
        if channel in unused or channel in scalars or (vague and guess.topic != pose["position"].guess.topic):
            continue
        values = field_values(log, guess)
        if values is not None and np.ptp(values) > 0 and not _is_misnamed(scalar := Scalar(guess, values[:, 0])):
            scalars[channel] = scalar
    return scalars


def _is_misnamed(scalar: Scalar) -> bool:
    """Return True if values contradict a name: a constant-forward gear, an angle as gear, an acceleration as pedal."""
    guess, values = scalar.guess, scalar.values
    if guess.rank == ACCELERATOR:
        return bool(guess.unit) or float(values.min()) < 0
    if guess.channel != "gear":
        return False
    return float(values.min()) >= 0 if guess.rank == MOTION else guess.rank > 0 and len(np.unique(values)) > MOST_GEARS


def _entry(channel: str, scalar: Scalar) -> Entry:
    """Infer scale and wrap from the values: controls to 0..1, engine speed to 1000 rev/min."""
    guess = scalar.guess
    if guess.rank == MOTION:
        return Entry(guess, *motion_settings(channel, scalar.values, guess.unit))
    wrap, values = scalar.unwrapped
    high = float(np.percentile(values, 99.5))
    note = ""
    if channel in PEDALS:
        settings, note = pedal_settings(channel, guess, values)
    elif settings := unit_setting(channel, guess):
        note = "in the unit of the log"
    elif channel == "gear":
        settings = gear_values(guess, values)
        note = "`values` may have to say what is recorded" if settings else "of its numbers the sign counts"
    elif channel == "engine_rpm" and high > 20 and not guess.unit:
        settings = {"unit": "rev/min"}
    return Entry(guess, wrap | settings, note)
