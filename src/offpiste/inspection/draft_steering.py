"""Steering of a first rig: commands, angles of the road wheels and of the steering wheel."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from offpiste.inspection.channel_guesses import FALLBACK, MOTION
from offpiste.inspection.commanded_motion import motion_lines
from offpiste.inspection.draft_pedals import LARGEST_SHARE, Scalar, are_named_pulses
from offpiste.inspection.draft_pose import Entry, unit_line
from offpiste.inspection.signal_faults import find_spikes
from offpiste.inspection.usual_ranges import RANGES, steering_middle
from offpiste.rig.channels import unit_factor
from offpiste.rig.edits import number, rounded
from offpiste.rig.labels import channel_unit, is_named, parse_label

_ALIKE: Final = (0.9, 1.1)
"""Ratio of the largest command to the largest measured angle if the command is an angle."""


def draft_steering(scalars: Mapping[str, Scalar], straight: float | None, max_steer: float) -> dict[str, Entry]:
    """Return commands and angles of the steering; an angle without a command serves as the command, too.

    Args:
        straight, max_steer: see `offpiste.inspection.draft_channels.Known`.
    """
    steer, angle = scalars.get("steer"), scalars.get("steer_angle")
    in_hand: dict[str, Entry] = {}
    if angle is not None and not _to_radians(angle):  # steering wheel angle
        in_hand = _in_hand(steer, angle, max_steer)
        steer, angle = steer if steer is not None and steer.guess.rank < FALLBACK else angle, None
    elif angle is not None and steer is not None and steer.guess.rank >= FALLBACK:
        steer = None
    command = steer or angle
    if command is None:
        return {}
    factor = _to_radians(command) if _is_angle(command) else 0.0
    if not factor and steer is not None and angle is not None and _are_alike(steer, angle):
        factor = _to_radians(angle)
    if factor and angle is None and not command.guess.asked_for:
        angle = command
    measured = command is angle
    entries = {"steer": _from_angle(command, factor, measured=measured) if factor else _command(command, straight)}
    if angle is not None:
        factor = _to_radians(angle)
        unit = channel_unit("steer_angle", angle.guess.unit) if angle.guess.unit else "deg" if factor != 1 else ""
        lines = (f'unit = "{unit}"',) if unit else ()
        comment = "GUESSED by its name and numbers: an angle of the road wheels"
        entries["steer_angle"] = Entry(angle.guess, lines, comment)
        if not entries["steer"].max_angle:
            stated = rounded(angle.largest * factor / min(command.largest, 1.0))
            entries["steer"] = replace(entries["steer"], max_angle=stated if stated < RANGES["steepest"] else 0.0)
    return entries | in_hand


def _in_hand(steer: Scalar | None, angle: Scalar, max_steer: float) -> dict[str, Entry]:
    """Return the road wheel angle from the steering wheel angle, scaled by a command of it in the same unit."""
    if steer is None or not (max_steer and steer.guess.asked_for and _is_angle(steer)) or _to_radians(steer):
        return {}
    if steer.guess.unit != angle.guess.unit or not 0.5 < angle.largest / steer.largest < 2:
        return {}
    comment = (
        f"GUESSED: of a steering wheel, of which {steer.largest:.4g} turn the road wheels by max_steer; correct it with"
        " that"
    )
    return {"steer_angle": Entry(angle.guess, (f"scale = {number(max_steer / steer.largest)}",), comment)}


def _are_alike(steer: Scalar, angle: Scalar) -> bool:
    """Return True if a unitless command has the values of the measured angle; as a share, 1 would be 1 rad."""
    return not steer.guess.unit and _ALIKE[0] < steer.largest / angle.largest < _ALIKE[1]


def _from_angle(steer: Scalar, factor: float, *, measured: bool) -> Entry:
    """Return a steering command from an angle, scaled to 1 at its maximum, the vehicle's `max_steer`."""
    unit = channel_unit("steer_angle", steer.guess.unit) if steer.guess.unit else "rad" if factor == 1 else "deg"
    comment = "GUESSED: an angle of the road wheels, which is divided by max_steer"
    comment += "; no command is recorded, and the angle stands for it" if measured else ""
    lines = (f'unit = "{unit or "rad"}"', "clip = [-1.0, 1.0]")
    return Entry(steer.guess, lines, comment, rounded(steer.largest * factor))


def _command(steer: Scalar, straight: float | None) -> Entry:
    """Return a steering command scaled to -1..1 by its unit or by its values."""
    guess = steer.guess
    if guess.rank == MOTION:
        return Entry(guess, *motion_lines("steer", steer.values, guess.unit))
    wrap, values = steer.unwrapped
    comment = "GUESSED by its name"
    low, high = np.percentile(values, (0.5, 99.5))
    largest, curvature = max(-low, high), is_named("curvature", *guess.fields)
    if largest > LARGEST_SHARE and (stated := unit_line("steer", guess)):
        return Entry(guess, (*wrap, *stated), f"{comment} and unit")
    lines: tuple[str, ...] = ()
    middle = None
    if largest > LARGEST_SHARE and not curvature:
        middle = steering_middle(values, named=are_named_pulses(guess), straight=straight)
    if middle is not None and middle[1] > 0:
        centre, reach, words = middle
        lines = f"scale = {number(1 / reach)}", f"offset = {number(-centre / reach)}", "clip = [-1.0, 1.0]"
        comment += f" and numbers: {words}"
    elif largest > LARGEST_SHARE or curvature:
        largest = float(np.abs(values[~find_spikes(values)]).max())
        lines = f"scale = {number(1 / largest)}", "clip = [-1.0, 1.0]"
        comment += f"; scaled by its largest value, {largest:.4g}"
        if curvature:
            comment += ": a curvature, max_steer is the angle of the road wheels that it asks for"
        elif _is_angle(steer) or largest > RANGES["steering_wheel"]:
            comment += ": of a steering wheel, max_steer is that over the steering's ratio"
        elif largest < RANGES["steepest"] * 180 / np.pi:
            comment += ': is it an angle of the road wheels? Then unit = "deg" instead'
    elif low > 0 and 0.3 < np.median(values) < 0.7:
        lines, comment = ("scale = 2.0", "offset = -1.0"), f"{comment}; 0..1 read as -1..1"
    return Entry(guess, (*wrap, *lines), comment)


def _is_angle(steer: Scalar) -> bool:
    unit = steer.guess.unit
    return steer.guess.channel == "steer_angle" or bool(unit and channel_unit("steer_angle", unit) is not None)


def _to_radians(steer: Scalar) -> float:
    """Return the factor to radians of a road wheel angle; 0 if it is too large or is the steering wheel's."""
    guess = steer.guess
    names = (guess.topic, *guess.fields, *(parse_label(name).name for name in guess.fields))
    if guess.in_hand or is_named("steering_wheel", *names):
        return 0.0
    units = [channel_unit("steer_angle", guess.unit) or ""] if guess.unit else ["", "deg"]
    factors = (unit_factor("steer_angle", unit) for unit in units)
    return next((factor for factor in factors if 0 < steer.largest * factor <= RANGES["widest"]), 0.0)
