"""Pedals of a first rig: usual scales, and combined throttle and brake columns."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from offpiste.inspection.channel_guesses import MOTION, Guess
from offpiste.inspection.draft_pose import Entry, unit_line
from offpiste.inspection.gear import DIRECTION
from offpiste.inspection.signal_faults import find_wrap
from offpiste.inspection.usual_ranges import (
    RANGES,
    are_pulses,
    full_scale,
    held_range,
    is_signed,
    largest_size,
    pulse_at_rest,
    rests_between,
    rests_high,
    scaled_to_unit,
    seen_range,
    whole_range,
)
from offpiste.logs.channel import unwrapped
from offpiste.rig.channels import ChannelSource
from offpiste.rig.edits import number
from offpiste.rig.labels import channel_unit, is_named

PEDALS: Final = ("throttle", "brake", "brake_pressure")
LARGEST_SHARE: Final = 1.05
"""Maximum value of a control from 0 to 1 or -1 to 1; larger ones have a unit or another scale."""
_BELOW: Final = 0.05
"""Minimum range below the rest position of a pedal that also brakes, as a share of the range above."""


@dataclass(frozen=True)
class Scalar:
    """Guess of a scalar channel with its finite values."""

    guess: Guess
    values: Float[np.ndarray, " n"]

    def of(self, **changes: Any) -> "Scalar":
        """Return the same values with a changed guess."""
        return replace(self, guess=replace(self.guess, **changes))

    @cached_property
    def largest(self) -> float:
        """Maximum magnitude without spikes."""
        return largest_size(self.values)

    @property
    def unwrapped(self) -> tuple[tuple[str, ...], Float[np.ndarray, " n"]]:
        """The line of TOML that unwraps a wrapped counter, if it is one, and the unwrapped values."""
        wrap = find_wrap(self.values)
        if wrap is None:
            return (), self.values
        return (f"wrap = {{ above = {number(wrap.above)}, period = {wrap.period} }}",), unwrapped(self.values, wrap)


def pedal_lines(channel: str, guess: Guess, values: Float[np.ndarray, " n"]) -> tuple[tuple[str, ...], str]:
    """Return lines that scale a pedal to 0..1, and the reason: usual logger ranges, otherwise the range in this log."""
    low, high = np.percentile(values, (0.5, 99.5))
    # A pedal may be pressed rarely.
    reached = max(-low, high, held_range(values)[1])
    if reached > LARGEST_SHARE and (stated := unit_line(channel, guess)):
        return stated, " and unit"
    span = seen_range(values)
    rests_above_zero = rests_high(values) is False and span[0] > 0.05 and span[1] <= LARGEST_SHARE
    if low >= -0.05 and 0.05 < high <= LARGEST_SHARE and not rests_above_zero:
        return (), ""
    # Pressures have no usual range.
    measured = guess.channel == "brake_pressure" or bool(guess.unit and channel_unit(channel, guess.unit) is None)
    whole = None if measured else whole_range(values)
    if whole == (0.0, 100.0):
        return ('unit = "percent"', "clip = [0.0, 1.0]"), f" and its numbers up to {span[1]:.4g}: taken as percent"
    source = ChannelSource(guess.fields, guess.topic)
    edits = scaled_to_unit(channel, source, whole or span, turned=bool(whole and whole[0] and rests_high(values)))
    seen = f"{span[0]:.4g}..{span[1]:.4g}"
    if whole:
        comment = f" and its numbers: of {whole[0]:g}..{whole[1]:g}, {seen} seen"
    else:
        fully = "is that full braking?" if guess.channel == "brake_pressure" else "is it fully pressed?"
        seen = f"{seen} {guess.unit if measured else ''}".rstrip()
        comment = f"; scaled from {seen} to 0..1, the most that this log holds: {fully}"
    lines = (f"{edit.key.rpartition('.')[2]} = {number(edit.value)}" for edit in edits)
    return (*lines, "clip = [0.0, 1.0]"), comment


def signed_pedal(scalars: Mapping[str, Scalar], *, backwards: bool = False) -> dict[str, Entry]:
    """Return throttle and brake (values below rest) if one column holds both, otherwise nothing.

    Args:
        backwards: True if values below rest drive backwards: throttle and gear.
    """
    throttle = scalars.get("throttle")
    if throttle is None or throttle.guess.rank == MOTION:
        return {}
    guess, (low, high) = throttle.guess, held_range(throttle.values)
    words = f"GUESSED by its name and numbers, {low:.4g}..{high:.4g}"
    if are_pulses(throttle.values, named=are_named_pulses(guess)):
        rest = pulse_at_rest(throttle.values)
        full = RANGES["full_pulse"] - rest
        lines: tuple[str, ...] = (f"scale = {number(1 / full)}", f"offset = {number(-rest / full)}")
        words += f", pulses (is full throttle {RANGES['full_pulse']:g}?)"
    elif _is_two_way(throttle, is_only="brake" not in scalars):
        rest, (lines, full) = 0.0, _scaled(guess, max(-low, high))
    else:
        return {}
    both = rest - low > _BELOW * (high - rest)
    if backwards and both and "gear" not in scalars:
        scale = DIRECTION / full
        gear = (f"scale = {number(scale)}", *((f"offset = {number(-rest * scale)}",) if rest else ()))
        return {
            "throttle": Entry(guess, (*lines, "absolute = true", "clip = [0.0, 1.0]"), f"{words}: its size"),
            "gear": Entry(guess, gear, f"{words}: what is below {rest:g} drives backwards"),
        }
    entries = {"throttle": Entry(guess, (*lines, "clip = [0.0, 1.0]"), f"{words}: what is above {rest:g}")}
    if both and "brake" not in scalars:
        words += f": what is below {rest:g} brakes"
        entries["brake"] = Entry(guess, (*lines, "sign = -1", "clip = [0.0, 1.0]"), words)
    return entries


def _is_two_way(throttle: Scalar, *, is_only: bool) -> bool:
    """Return True for a signed pedal; a trigger rests at an end of its range, but so may a throttle if it is all."""
    values = throttle.values
    trigger = not is_only and rests_high(values) and not rests_between(values)
    return find_wrap(values) is None and is_signed(values) and not trigger


def _scaled(guess: Guess, largest: float) -> tuple[tuple[str, ...], float]:
    """Return the lines that scale a signed pedal to -1..1, and its recorded full scale."""
    if largest <= LARGEST_SHARE:
        return (), 1.0
    full = full_scale(largest) or largest
    lines = unit_line("throttle", guess)
    if not lines:
        lines = ('unit = "percent"',) if full == 100 else (f"scale = {number(1 / full)}",)
    return lines, 100.0 if lines == ('unit = "percent"',) else full


def are_named_pulses(guess: Guess) -> bool:
    """Return True if the unit or the name marks pulse widths."""
    return guess.unit == "us" or is_named("pulsed", guess.topic, *guess.fields)
