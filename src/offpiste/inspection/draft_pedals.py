"""Pedals of a first rig: usual scales, and combined throttle and brake columns."""

import re
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.inspection.channel_guesses import MOTION, Guess
from offpiste.inspection.draft_pose import Entry, unit_line
from offpiste.inspection.gear import DIRECTION
from offpiste.inspection.signal_faults import find_wrap
from offpiste.inspection.usual_ranges import (
    FULL_PULSE,
    are_pulses,
    full_scale,
    held_range,
    is_signed,
    pulse_at_rest,
    rests_between,
    rests_high,
    scaled_to_unit,
    seen_range,
    whole_range,
)
from offpiste.rig.channels import ChannelSource
from offpiste.rig.edits import number
from offpiste.rig.labels import channel_unit

_PULSED: Final = re.compile(r"servo|pwm|pulse|(?<![a-z])(esc|rc)(?![a-z])", re.IGNORECASE)
_SLACK: Final = 25.0
"""Tolerance below the rest pulse that does not count as braking [us]."""

Scalars = dict[str, tuple[Guess, Float[np.ndarray, " n"]]]
"""Guesses of scalar channels, and their values."""


def rests_above_zero(values: Float[np.ndarray, " n"]) -> bool:
    """Return True if a pedal within 0 to 1 is released well above 0."""
    low, high = seen_range(values)
    return rests_high(values) is False and low > 0.05 and high <= 1.05


def pedal_lines(channel: str, guess: Guess, values: Float[np.ndarray, " n"]) -> tuple[list[str], str]:
    """Return lines that scale a pedal to 0..1, and the reason: usual logger ranges, otherwise the range in this log."""
    low, high = seen_range(values)
    # Pressures have no usual range.
    measured = guess.channel == "brake_pressure" or bool(guess.unit and channel_unit(channel, guess.unit) is None)
    span = None if measured else whole_range(values)
    if span == (0.0, 100.0):
        return ['unit = "percent"', "clip = [0.0, 1.0]"], f" and its numbers up to {high:.4g}: taken as percent"
    source = ChannelSource(guess.fields, guess.topic)
    edits = scaled_to_unit(channel, source, span or (low, high), turned=bool(span and span[0] and rests_high(values)))
    lines = [f"{edit.key.rpartition('.')[2]} = {number(edit.value)}" for edit in edits]
    seen = f"{low:.4g}..{high:.4g} {guess.unit if measured else ''}".rstrip()
    fully = "is that full braking?" if guess.channel == "brake_pressure" else "is it fully pressed?"
    comment = f"; scaled from {seen} to 0..1, the most that this log holds: {fully}"
    if span:
        comment = f" and its numbers: of {span[0]:g}..{span[1]:g}, {low:.4g}..{high:.4g} seen"
    return [*lines, "clip = [0.0, 1.0]"], comment


def signed_pedal(scalars: Scalars, *, backwards: bool = False) -> dict[str, Entry]:
    """Return throttle and brake (negative values) if one column holds both, otherwise nothing.

    Args:
        backwards: True if negative values drive backwards: throttle and gear.
    """
    if "throttle" not in scalars or scalars["throttle"][0].rank == MOTION:
        return {}
    guess, values = scalars["throttle"]
    if are_pulses(values, named=are_named_pulses(guess)):
        return _pulsed_pedal(guess, values, alone="brake" not in scalars, backwards=backwards)
    # A trigger rests at an end of its range, but so does a throttle that is often fully open.
    trigger = "brake" in scalars and rests_high(values) and not rests_between(values)
    if find_wrap(values) is not None or not is_signed(values) or trigger:
        return {}
    low, high = held_range(values)
    largest = max(-low, high)
    scaled, full = unit_line("throttle", guess) if largest > 1.05 else (), 1.0
    if not scaled and largest > 1.05:
        full = full_scale(largest) or largest
        scaled = ('unit = "percent"',) if full == 100 else (f"scale = {number(1 / full)}",)
    comment = f"GUESSED by its name and numbers, {low:.4g}..{high:.4g}: "
    if backwards and "gear" not in scalars:
        return _both_ways(guess, scaled, comment, 100.0 if scaled == ('unit = "percent"',) else full)
    entries = {"throttle": Entry(guess, (*scaled, "clip = [0.0, 1.0]"), comment + "what is above zero")}
    if "brake" not in scalars:
        lines = (*scaled, "sign = -1", "clip = [0.0, 1.0]")
        entries["brake"] = Entry(guess, lines, comment + "what is below zero brakes")
    return entries


def _both_ways(guess: Guess, lines: tuple[str, ...], comment: str, full: float, rest: float = 0.0) -> dict[str, Entry]:
    """Return throttle and gear of a pedal whose values below rest drive the vehicle backwards.

    Args:
        lines: scale of the throttle.
        full: recorded amplitude of full throttle.
        rest: recorded value of the released pedal.
    """
    scale = DIRECTION / full
    offset = (f"offset = {number(-rest * scale)}",) if rest else ()
    throttle = Entry(guess, (*lines, "absolute = true", "clip = [0.0, 1.0]"), f"{comment}its size")
    way = Entry(guess, (f"scale = {number(scale)}", *offset), f"{comment}what is below {rest:g} drives backwards")
    return {"throttle": throttle, "gear": way}


def _pulsed_pedal(guess: Guess, values: Float[np.ndarray, " n"], *, alone: bool, backwards: bool) -> dict[str, Entry]:
    """Return the throttle from speed controller pulses [us], and the brake or gear if no other field provides them."""
    rest = pulse_at_rest(values)
    low, high = held_range(values)
    whole = FULL_PULSE - rest
    both = rest - low > _SLACK
    lines = (f"scale = {number(1 / whole)}", f"offset = {number(-rest / whole)}")
    words = f"GUESSED by its name and numbers: pulses, released at {rest:g}, {low:.4g}..{high:.4g} seen: "
    words += f"is full throttle {FULL_PULSE:g}?"
    if alone and both and backwards:
        return _both_ways(guess, lines, f"{words}; ", whole, rest)
    entries = {"throttle": Entry(guess, (*lines, "clip = [0.0, 1.0]"), words)}
    if alone and both:
        entries["brake"] = Entry(guess, (*lines, "sign = -1", "clip = [0.0, 1.0]"), words + "; what is below it brakes")
    return entries


def are_named_pulses(guess: Guess) -> bool:
    """Return True if the unit or the name marks pulse widths."""
    return guess.unit == "us" or any(_PULSED.search(name) for name in (guess.topic, *guess.fields))
