"""Channels of a draft rig: selected guesses, with units, scales and signs inferred from names and values."""

import re
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.inspection.channel_guesses import (
    ACCELERATOR,
    FALLBACK,
    MEASURED,
    MOTION,
    Guess,
    guess_channels,
    of_one_vehicle,
    other_vehicle,
)
from offpiste.inspection.commanded_motion import motion_lines
from offpiste.inspection.draft_pedals import (
    Scalars,
    are_named_pulses,
    pedal_lines,
    rests_above_zero,
    signed_pedal,
)
from offpiste.inspection.draft_pose import Entry, degrees, draft_pose, field_values, unit_line
from offpiste.inspection.draft_values import WIDEST
from offpiste.inspection.gear import MOST_GEARS, gear_values
from offpiste.inspection.signal_faults import find_spikes, find_wrap
from offpiste.inspection.usual_ranges import held_range, largest_size, steering_middle
from offpiste.logs.channel import unwrapped
from offpiste.logs.log import Log
from offpiste.rig.channels import unit_factor
from offpiste.rig.edits import number
from offpiste.rig.labels import channel_unit, is_array_entry, parse_label

_VECTORS: Final = ("position", "orientation", "linear_velocity", "angular_velocity")
_IN_HAND: Final = re.compile(
    r"(steering|hand)[ _]?wheel|(steer|str|stg)_?whl|(?<![a-z])swa?(?![a-z])|carState\.steer", re.IGNORECASE
)
"""Names of the steering wheel."""
_PEDAL: Final = 1.05
"""Maximum value of a pedal; commanded speeds exceed it [m/s]."""
_STEERING_WHEEL: Final = 130.0
"""Minimum full-scale value in degrees that implies the steering wheel's angle."""
_STEEPEST: Final = 1.4
"""Maximum drafted `max_steer` [rad]."""
_ALIKE: Final = (0.9, 1.1)
"""Ratio of the largest command to the largest measured angle if the command is an angle."""

Found = Mapping[str, tuple[Guess, float]]
"""Guesses of controls found by the vehicle's response only, with their correlation (`controls_by_numbers`)."""


def draft_channels(
    log: Log,
    frame: str,
    found: Found = MappingProxyType({}),
    straight: float | None = None,
    *,
    plain: bool = False,
    max_steer: float = 0.0,
    backwards: bool = False,
    in_hand: bool = False,
) -> dict[str, Entry]:
    """Return entries by channel, the pose's first.

    Args:
        frame: of the linear velocity.
        found: controls found by the vehicle's response only.
        straight: recorded steering in straight driving, if known from the motion.
        plain: True if fields named as speed and turn rate are throttle and steering themselves.
        max_steer: road wheel angle at a steering command of 1 [rad], if known from the motion, otherwise 0.
        backwards: True if negative pedal values drive backwards.
        in_hand: True if the steering angle is the steering wheel's.
    """
    guesses = [_as_it_is(guess) if plain else guess for guess in guess_channels(log)]
    entries = draft_pose(log, guesses, frame)
    pose_topic = entries["position"].guess.topic if "position" in entries else ""
    scalars: Scalars = {}
    for guess in of_one_vehicle(guesses, pose_topic):
        commanded = guess.channel == "steer_angle" and guess.rank < MEASURED and guess.asked_for
        channel = "steer" if commanded else guess.channel
        if channel in scalars or channel in (*entries, *_VECTORS):
            continue
        if channel == "yaw" and ("orientation" in entries or "position" not in entries):
            continue
        if channel == "yaw_rate" and "angular_velocity" in entries:
            continue
        if channel == "wheel_speed" and guess.rank > 1 and guess.topic != pose_topic:
            continue
        values = field_values(log, guess)
        if values is not None and np.ptp(values) > 0 and not _is_misnamed(guess, values):
            scalars[channel] = guess, values[:, 0]
    for channel, (guess, _) in found.items():
        if channel not in scalars and (values := field_values(log, guess)) is not None:
            scalars[channel] = guess, values[:, 0]
    if plain and "throttle" in scalars and np.abs(scalars["throttle"][1]).max() <= _PEDAL:
        scalars.pop("gear", None)
        scalars["throttle"] = replace(scalars["throttle"][0], unit="", rank=1), scalars["throttle"][1]
    if "brake" not in scalars and "brake_pressure" in scalars:
        scalars["brake"] = scalars.pop("brake_pressure")  # used as the command
    if "steer" not in scalars and "steer_angle" in scalars and scalars["steer_angle"][0].rank == MEASURED:
        guess, numbers = scalars.pop("steer_angle")
        # Without a command, a position of any unit is the steering; a joint's position is an angle.
        scalars["steer"] = (guess if is_array_entry(guess.fields[0]) else replace(guess, channel="steer")), numbers
    if in_hand and (angle := scalars.get("steer_angle")) is not None:
        scalars["steer_angle"] = replace(angle[0], in_hand=True), angle[1]
    others = {name: _scalar(name, *scalar) for name, scalar in scalars.items() if name not in ("steer", "steer_angle")}
    entries |= others | signed_pedal(scalars, backwards=backwards) | _steering(scalars, straight, max_steer)
    for channel, (guess, correlation) in found.items():
        if channel in entries and entries[channel].guess is guess:
            follows = f"by its numbers: the motion follows it ({correlation:.2f})"
            comment = entries[channel].comment.removeprefix("GUESSED").removeprefix(" by its name").strip(":; ")
            if channel == "throttle" and "brake" in entries and entries["brake"].guess is guess:
                by_numbers = entries["brake"].comment.replace("by its name and numbers", "by its numbers")
                entries["brake"] = replace(entries["brake"], comment=by_numbers)
            entries[channel] = replace(entries[channel], comment=f"GUESSED {follows}{comment and '; '}{comment}")
    return entries


def of_other_vehicles(entries: Mapping[str, Entry]) -> list[str]:
    """Return comments that list controls and actuators on topics named for another vehicle."""
    others: dict[tuple[str, str], list[str]] = {}
    for channel, entry in entries.items():
        names = other_vehicle(entry.guess.topic, entries["position"].guess.topic)
        if names is not None and channel not in (*_VECTORS, "yaw", "yaw_rate"):
            others.setdefault(names, []).append(channel)
    return [
        f"# MISSING: {', '.join(channels)} of {pose}: those of {taken} are read, another vehicle by its name. "
        "Give its own, or declare them absent.\n"
        for (taken, pose), channels in others.items()
    ]


def _is_misnamed(guess: Guess, values: Float[np.ndarray, "n k"]) -> bool:
    """Return True if values contradict a name: a constant-forward gear, an angle as gear, an acceleration as pedal."""
    if guess.rank == ACCELERATOR:
        return bool(guess.unit) or float(values.min()) < 0
    if guess.channel != "gear":
        return False
    return float(values.min()) >= 0 if guess.rank == MOTION else guess.rank > 0 and len(np.unique(values)) > MOST_GEARS


def _as_it_is(guess: Guess) -> Guess:
    """Convert a commanded turn rate to a steering of arbitrary unit."""
    turns = guess.rank == MOTION and guess.channel == "steer"
    return replace(guess, fields=guess.fields[:1], unit="", rank=1) if turns else guess


def _scalar(channel: str, guess: Guess, values: Float[np.ndarray, " n"], straight: float | None = None) -> Entry:
    """Infer scale and wrap from the values: controls to 0..1 or -1..1, engine speed to 1000 rev/min."""
    if guess.rank == MOTION:
        return Entry(guess, *motion_lines(channel, values, guess.unit))
    lines: list[str] = []
    comment = "GUESSED by its name"
    wrap = find_wrap(values)
    if wrap is not None:
        lines.append(f"wrap = {{ above = {number(wrap.above)}, period = {wrap.period} }}")
        values = unwrapped(values, wrap)
    low, high = np.percentile(values, (0.5, 99.5))
    largest = max(-low, high)
    stated = unit_line(channel, guess)
    # A pedal may be pressed rarely.
    pressed = ("throttle", "brake", "brake_pressure")
    reached = max(largest, held_range(values)[1]) if channel in pressed else largest
    if stated and (channel not in (*pressed, "steer") or reached > 1.05):
        lines += stated
        comment += " and unit"
    elif channel in pressed and (rests_above_zero(values) or not (low >= -0.05 and 0.05 < high <= 1.05)):
        pedal, words = pedal_lines(channel, guess, values)
        lines += pedal
        comment += words
    elif (
        channel == "steer"
        and largest > 1.05
        and not _is_curvature(guess)
        and (around := steering_middle(values, named=are_named_pulses(guess), straight=straight))
        and around[1] > 0
    ):
        middle, reach, words = around
        lines += [f"scale = {number(1 / reach)}", f"offset = {number(-middle / reach)}", "clip = [-1.0, 1.0]"]
        comment += f" and numbers: {words}"
    elif channel == "steer" and (largest > 1.05 or _is_curvature(guess)):
        largest = float(np.abs(values[~find_spikes(values)]).max())
        lines += [f"scale = {number(1 / largest)}", "clip = [-1.0, 1.0]"]
        comment += f"; scaled by its largest value, {largest:.4g}"
        if _is_curvature(guess):
            comment += ": a curvature, max_steer is the angle of the road wheels that it asks for"
        elif _is_angle(guess) or largest > _STEERING_WHEEL:
            comment += ": of a steering wheel, max_steer is that over the steering's ratio"
        elif largest < _STEEPEST * 180 / np.pi:
            comment += ': is it an angle of the road wheels? Then unit = "deg" instead'
    elif channel == "steer" and low > 0 and 0.3 < np.median(values) < 0.7:
        lines += ["scale = 2.0", "offset = -1.0"]
        comment += "; 0..1 read as -1..1"
    elif channel == "engine_rpm" and high > 20 and not guess.unit:
        lines.append('unit = "rev/min"')
    elif channel == "yaw" and not guess.unit:
        lines += degrees(values)
    elif channel == "gear":
        lines += gear_values(guess, values)
        comment += "; `values` may have to say what is recorded" if lines else "; of its numbers the sign counts"
    return Entry(guess, tuple(lines), comment)


def _steering(scalars: Scalars, straight: float | None, max_steer: float) -> dict[str, Entry]:
    """Return commands and angles of the steering; an angle without a command serves as the command, too."""
    steer, angle = scalars.get("steer"), scalars.get("steer_angle")
    in_hand: dict[str, Entry] = {}
    if angle is not None and not _angle_factor(*angle):  # steering wheel angle
        if steer is not None and max_steer and steer[0].asked_for and not _angle_factor(*steer):
            in_hand = _in_hand(steer, angle, max_steer)
        steer, angle = steer if steer is not None and steer[0].rank < FALLBACK else angle, None
    if steer is not None and steer[0].rank >= FALLBACK and angle is not None:
        steer = None
    command = steer or angle
    if command is None:
        return {}
    commanded = _angle_factor(*command) if _is_angle(command[0]) else 0.0
    if not commanded and steer is not None and angle is not None and _are_alike(steer, angle):
        commanded = _angle_factor(*angle)
    if commanded and angle is None and not command[0].asked_for:
        angle = steer
    entries: dict[str, Entry] = {}
    if commanded:
        entries["steer"] = _from_angle(*command, commanded, measured=command is angle)
    else:
        entries["steer"] = _scalar("steer", *command, straight)
    if angle is not None:
        factor = _angle_factor(*angle)
        unit = channel_unit("steer_angle", angle[0].unit) if angle[0].unit else "deg" if factor != 1 else ""
        lines = (f'unit = "{unit}"',) if unit else ()
        entries["steer_angle"] = Entry(angle[0], lines, "GUESSED by its name and numbers: an angle of the road wheels")
        if not commanded:
            stated = largest_size(angle[1]) * factor / min(largest_size(command[1]), 1.0)
            entries["steer"] = replace(
                entries["steer"], max_angle=float(f"{stated:.4g}") if stated < _STEEPEST else 0.0
            )
    return entries | in_hand


def _in_hand(
    steer: tuple[Guess, Float[np.ndarray, " n"]], angle: tuple[Guess, Float[np.ndarray, " n"]], max_steer: float
) -> dict[str, Entry]:
    """Return the road wheel angle from the steering wheel angle, scaled by a command in the same unit."""
    largest = largest_size(steer[1])
    if not (_is_angle(steer[0]) and steer[0].unit == angle[0].unit and 0.5 < largest_size(angle[1]) / largest < 2):
        return {}
    comment = (
        f"GUESSED: of a steering wheel, of which {largest:.4g} turn the road wheels by max_steer; correct it with that"
    )
    return {"steer_angle": Entry(angle[0], (f"scale = {number(max_steer / largest)}",), comment)}


def _are_alike(steer: tuple[Guess, np.ndarray], angle: tuple[Guess, np.ndarray]) -> bool:
    """Return True if a unitless command has the values of the measured angle; as a share, 1 would be 1 rad."""
    return not steer[0].unit and _ALIKE[0] < largest_size(steer[1]) / largest_size(angle[1]) < _ALIKE[1]


def _from_angle(guess: Guess, values: Float[np.ndarray, " n"], factor: float, *, measured: bool) -> Entry:
    """Return a steering command from an angle, scaled to 1 at its maximum, the vehicle's `max_steer`."""
    max_angle = float(f"{largest_size(values) * factor:.4g}")
    unit = channel_unit("steer_angle", guess.unit) if guess.unit else "rad" if factor == 1 else "deg"
    lines = (f'unit = "{unit or "rad"}"', "clip = [-1.0, 1.0]")
    comment = "GUESSED: an angle of the road wheels, which is divided by max_steer"
    comment += "; no command is recorded, and the angle stands for it" if measured else ""
    return Entry(guess, lines, comment, max_angle)


def _is_angle(guess: Guess) -> bool:
    return guess.channel == "steer_angle" or bool(guess.unit and channel_unit("steer_angle", guess.unit) is not None)


def _is_curvature(guess: Guess) -> bool:
    return any(re.search("curvature", field, re.IGNORECASE) for field in guess.fields)


def _is_in_hand(guess: Guess) -> bool:
    """Return True if the name or the motion marks a steering wheel angle."""
    named = (parse_label(field).name for field in guess.fields)
    return guess.in_hand or any(map(_IN_HAND.search, (guess.topic, *guess.fields, *named)))


def _angle_factor(guess: Guess, values: Float[np.ndarray, " n"]) -> float:
    """Return the factor to radians of a road wheel angle; 0 if it is too large or named otherwise."""
    if _is_in_hand(guess):
        return 0.0
    if guess.unit:
        factors = [unit_factor("steer_angle", channel_unit("steer_angle", guess.unit) or "")]
    else:
        factors = [1.0, unit_factor("steer_angle", "deg")]
    return next((factor for factor in factors if 0 < largest_size(values) * factor <= WIDEST), 0.0)
