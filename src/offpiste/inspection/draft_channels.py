"""Channels of a first rig: selected guesses, with units, scales and signs inferred from names and values."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from offpiste.inspection.commanded_motion import motion_settings
from offpiste.inspection.draft_pose import POSE_CHANNELS, Entry, draft_pose, unit_setting
from offpiste.inspection.gear import DIRECTION, MOST_GEARS, gear_values
from offpiste.inspection.missing import no_pose
from offpiste.inspection.naming import ACCELERATOR, FALLBACK, MEASURED, MOTION, Guess, field_values
from offpiste.inspection.signal_faults import find_spikes, find_wrap
from offpiste.inspection.usual_ranges import (
    RANGES,
    full_scale,
    held_range,
    is_signed,
    largest_size,
    pulse_at_rest,
    rests_between,
    rests_high,
    scaled_to_unit,
    seen_range,
    steering_middle,
    whole_range,
)
from offpiste.logs.channel import unwrapped
from offpiste.logs.log import Log
from offpiste.rig.channels import ANGLES, ChannelSource
from offpiste.rig.edits import rounded
from offpiste.rig.labels import channel_unit, is_array_entry, is_named, parse_label

_PEDALS: Final = ("throttle", "brake", "brake_pressure")
LARGEST_SHARE: Final = 1.05
"""Maximum value of a control from 0 to 1 or -1 to 1; larger ones have a unit or another scale."""
_BELOW: Final = 0.05
"""Minimum range below the rest position of a pedal that also brakes, as a share of the range above."""
_SHARE: Final = {"clip": [0.0, 1.0]}
_BOTH_WAYS: Final = {"clip": [-1.0, 1.0]}
_PERCENT: Final = {"unit": "percent"}
_ALIKE: Final = (0.9, 1.1)
"""Ratio of the largest command to the largest measured angle if the command is an angle."""


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


@dataclass(frozen=True)
class _Scalar:
    """Guess of a scalar channel with its finite values."""

    guess: Guess
    values: Float[np.ndarray, " n"]

    @cached_property
    def largest(self) -> float:
        """Maximum magnitude without spikes."""
        return largest_size(self.values)

    @property
    def unwrapped(self) -> tuple[dict[str, Any], Float[np.ndarray, " n"]]:
        """The setting that unwraps a wrapped counter, if it is one, and the unwrapped values."""
        wrap = find_wrap(self.values)
        if wrap is None:
            return {}, self.values
        return {"wrap": {"above": rounded(wrap.above), "period": wrap.period}}, unwrapped(self.values, wrap)


def draft_channels(log: Log, guesses: Sequence[Guess], facts: Facts) -> dict[str, Entry]:
    """Return entries by channel, the pose's first; the first guess of a channel with valid values is used.

    Raises:
        LogError: no pose was found, or its samples cannot be read.
    """
    if not (entries := draft_pose(log, guesses, facts.frame)):
        raise no_pose(log)
    scalars = _scalars(log, guesses, entries)
    if "brake" not in scalars and "brake_pressure" in scalars:
        scalars["brake"] = scalars.pop("brake_pressure")  # used as the command
    if "steer" not in scalars and "steer_angle" in scalars and scalars["steer_angle"].guess.rank == MEASURED:
        # Without a command, a position of any unit is the steering; a joint's position is an angle.
        angle = scalars.pop("steer_angle")
        channel = "steer_angle" if is_array_entry(angle.guess.fields[0]) else "steer"
        scalars["steer"] = replace(angle, guess=replace(angle.guess, channel=channel))
    steering = _steering(scalars, facts)
    others = {name: _entry(name, scalar) for name, scalar in scalars.items() if name not in ("steer", "steer_angle")}
    return entries | others | _signed_pedal(scalars, backwards=facts.backwards) | steering


def _scalars(log: Log, guesses: Sequence[Guess], pose: Mapping[str, Entry]) -> dict[str, _Scalar]:
    """Return the first guess of each scalar channel whose values vary and do not contradict the name."""
    unused = {*POSE_CHANNELS, *(["yaw_rate"] if "angular_velocity" in pose else [])}
    scalars: dict[str, _Scalar] = {}
    for guess in guesses:
        commanded = guess.channel == "steer_angle" and guess.rank < MEASURED and guess.is_command
        channel = "steer" if commanded else guess.channel
        vague = channel == "wheel_speed" and guess.rank > 1
        if channel in unused or channel in scalars or (vague and guess.topic != pose["position"].guess.topic):
            continue
        values = field_values(log, guess)
        if values is not None and np.ptp(values) > 0 and not _is_misnamed(scalar := _Scalar(guess, values[:, 0])):
            scalars[channel] = scalar
    return scalars


def _is_misnamed(scalar: _Scalar) -> bool:
    """Return True if values contradict a name: a constant-forward gear, an angle as gear, an acceleration as pedal."""
    guess, values = scalar.guess, scalar.values
    if guess.rank == ACCELERATOR:
        return bool(guess.unit) or float(values.min()) < 0
    if guess.channel != "gear":
        return False
    return float(values.min()) >= 0 if guess.rank == MOTION else guess.rank > 0 and len(np.unique(values)) > MOST_GEARS


def _entry(channel: str, scalar: _Scalar) -> Entry:
    """Infer scale and wrap from the values: controls to 0..1, engine speed to 1000 rev/min."""
    guess = scalar.guess
    if guess.rank == MOTION:
        return Entry(guess, *motion_settings(channel, scalar.values, guess.unit))
    wrap, values = scalar.unwrapped
    high = float(np.percentile(values, 99.5))
    note = ""
    if channel in _PEDALS:
        settings, note = _pedal_settings(channel, guess, values)
    elif settings := unit_setting(channel, guess):
        note = "in the unit of the log"
    elif channel == "gear":
        settings = gear_values(guess, values)
        note = "`values` may have to say what is recorded" if settings else "of its numbers the sign counts"
    elif channel == "engine_rpm" and high > 20 and not guess.unit:
        settings = {"unit": "rev/min"}
    return Entry(guess, wrap | settings, note)


def _pedal_settings(channel: str, guess: Guess, values: Float[np.ndarray, " n"]) -> tuple[dict[str, Any], str]:
    """Return settings that scale a pedal to 0..1, and a note: usual logger ranges, otherwise the range in this log."""
    low, high = np.percentile(values, (0.5, 99.5))
    # A pedal may be pressed rarely.
    reached = max(-low, high, held_range(values)[1])
    if reached > LARGEST_SHARE and (stated := unit_setting(channel, guess)):
        return stated, "in the unit of the log"
    span = seen_range(values)
    rests_above_zero = rests_high(values) is False and span[0] > 0.05 and span[1] <= LARGEST_SHARE
    if low >= -0.05 and 0.05 < high <= LARGEST_SHARE and not rests_above_zero:
        return {}, ""
    # Pressures have no usual range.
    measured = guess.channel == "brake_pressure" or bool(guess.unit and channel_unit(channel, guess.unit) is None)
    whole = None if measured else whole_range(values)
    if whole == (0.0, 100.0):
        return _PERCENT | _SHARE, f"up to {span[1]:.4g}: taken as percent"
    source = ChannelSource(guess.fields, guess.topic)
    edits = scaled_to_unit(channel, source, whole or span, turned=bool(whole and whole[0] and rests_high(values)))
    seen = f"{span[0]:.4g}..{span[1]:.4g}"
    if whole:
        note = f"of {whole[0]:g}..{whole[1]:g}, {seen} seen"
    else:
        fully = "is that full braking?" if guess.channel == "brake_pressure" else "is it fully pressed?"
        seen = f"{seen} {guess.unit if measured else ''}".rstrip()
        note = f"scaled from {seen} to 0..1, the most that this log holds: {fully}"
    return {edit.key.rpartition(".")[2]: edit.value for edit in edits} | _SHARE, note


def _signed_pedal(scalars: Mapping[str, _Scalar], *, backwards: bool = False) -> dict[str, Entry]:
    """Return throttle and brake (values below rest) if one column holds both, otherwise nothing.

    Args:
        backwards: True if values below rest drive backwards: throttle and gear.
    """
    throttle = scalars.get("throttle")
    if throttle is None or throttle.guess.rank == MOTION:
        return {}
    guess, (low, high) = throttle.guess, held_range(throttle.values)
    words, rest = f"{low:.4g}..{high:.4g} seen", 0.0
    if pulse := pulse_at_rest(throttle.values, named=_are_named_pulses(guess)):
        rest, full = pulse, RANGES["full_pulse"] - pulse
        settings = _scaled(full, rest)
        words += f", pulses (is full throttle {RANGES['full_pulse']:g}?)"
    elif _is_two_way(throttle, is_only="brake" not in scalars):
        largest = max(-low, high)
        full = 1.0 if largest <= LARGEST_SHARE else full_scale(largest) or largest
        settings = (
            {} if full == 1.0 else unit_setting("throttle", guess) or (_PERCENT if full == 100 else _scaled(full))
        )
        full = 100.0 if settings == _PERCENT else full
    else:
        return {}
    both = rest - low > _BELOW * (high - rest)
    if backwards and both and "gear" not in scalars:
        gear = _scaled(full / DIRECTION, rest)
        return {
            "throttle": Entry(guess, settings | {"absolute": True} | _SHARE, f"{words}: its size"),
            "gear": Entry(guess, gear, f"{words}: what is below {rest:g} drives backwards"),
        }
    entries = {"throttle": Entry(guess, settings | _SHARE, f"{words}: what is above {rest:g}")}
    if both and "brake" not in scalars:
        brake = settings | {"sign": -1} | _SHARE
        entries["brake"] = Entry(guess, brake, f"{words}: what is below {rest:g} brakes")
    return entries


def _is_two_way(throttle: _Scalar, *, is_only: bool) -> bool:
    """Return True for a signed pedal; beside a brake, a pedal that rests at its upper end is a trigger."""
    values = throttle.values
    trigger = not is_only and rests_high(values) and not rests_between(values)
    return find_wrap(values) is None and is_signed(values) and not trigger


def _scaled(full: float, zero: float = 0.0) -> dict[str, Any]:
    """Return the settings that map a recorded zero to 0 and `full` beyond it to 1."""
    return {"scale": rounded(1 / full)} | ({"offset": rounded(-zero / full)} if zero else {})


def _are_named_pulses(guess: Guess) -> bool:
    """Return True if the unit or the name marks pulse widths."""
    return guess.unit == "us" or is_named("pulsed", guess.topic, *guess.fields)


def _steering(scalars: Mapping[str, _Scalar], facts: Facts) -> dict[str, Entry]:
    """Return commands and angles of the steering; an angle without a command serves as the command, too."""
    steer, angle = scalars.get("steer"), scalars.get("steer_angle")
    handwheel: dict[str, Entry] = {}
    if angle is not None and not _road_unit(angle):  # steering wheel angle
        handwheel = _from_handwheel(steer, angle, facts.max_steer)
        steer, angle = steer if steer is not None and steer.guess.rank < FALLBACK else angle, None
    elif angle is not None and steer is not None and steer.guess.rank >= FALLBACK:
        steer = None
    command = steer or angle
    if command is None:
        return {}
    unit = _road_unit(command) if _is_angle(command) else ""
    if steer is not None and angle is not None and not steer.guess.unit:
        # As a share, 1 would be 1 rad.
        alike = _ALIKE[0] < steer.largest / angle.largest < _ALIKE[1]
        unit = unit or (_road_unit(angle) if alike else "")
    if unit and angle is None and not command.guess.is_command:
        angle = command
    if unit:
        note = "an angle of the road wheels, which is divided by max_steer"
        note += "; no command is recorded, and the angle stands for it" if command is angle else ""
        settings, largest = {"unit": unit} | _BOTH_WAYS, rounded(command.largest * ANGLES[unit])
        entry = Entry(command.guess, settings, note, largest)
    else:
        entry = _command(command, facts.straight)
    if angle is None:
        return {"steer": entry} | handwheel
    unit = _road_unit(angle)
    if not entry.max_angle:
        stated = rounded(angle.largest * ANGLES[unit] / min(command.largest, 1.0))
        entry = replace(entry, max_angle=stated if stated < RANGES["steepest"] else 0.0)
    measured = Entry(angle.guess, {"unit": unit} if unit != "rad" else {}, "an angle of the road wheels")
    return {"steer": entry, "steer_angle": measured}


def _from_handwheel(steer: _Scalar | None, angle: _Scalar, max_steer: float) -> dict[str, Entry]:
    """Return the road wheel angle from the steering wheel angle, scaled by a command of it in the same unit."""
    if steer is None or not (max_steer and steer.guess.is_command and _is_angle(steer)) or _road_unit(steer):
        return {}
    if steer.guess.unit != angle.guess.unit or not 0.5 < angle.largest / steer.largest < 2:
        return {}
    of = f"of a steering wheel, of which {steer.largest:.4g} turn the road wheels by max_steer; correct it with that"
    return {"steer_angle": Entry(angle.guess, _scaled(steer.largest / max_steer), of)}


def _command(steer: _Scalar, straight: float | None) -> Entry:
    """Return a steering command scaled to -1..1 by its unit or by its values."""
    guess = steer.guess
    if guess.rank == MOTION:
        return Entry(guess, *motion_settings("steer", steer.values, guess.unit))
    wrap, values = steer.unwrapped
    low, high = np.percentile(values, (0.5, 99.5))
    largest, curvature = max(-low, high), is_named("curvature", *guess.fields)
    settings: dict[str, Any] = {}
    note, middle = "", None
    if largest > LARGEST_SHARE and (stated := unit_setting("steer", guess)):
        return Entry(guess, wrap | stated, "in the unit of the log")
    if largest > LARGEST_SHARE and not curvature:
        middle = steering_middle(values, named=_are_named_pulses(guess), straight=straight)
    if middle is not None and middle[1] > 0:
        centre, reach, note = middle
        settings = _scaled(reach, centre) | _BOTH_WAYS
    elif largest > LARGEST_SHARE or curvature:
        largest = float(np.abs(values[~find_spikes(values)]).max())
        settings, note = _scaled(largest) | _BOTH_WAYS, f"scaled by its largest value, {largest:.4g}"
        if curvature:
            note += ": a curvature, max_steer is the angle of the road wheels that it asks for"
        elif _is_angle(steer) or largest > RANGES["steering_wheel"]:
            note += ": of a steering wheel, max_steer is that over the steering's ratio"
        elif largest < RANGES["steepest"] * 180 / np.pi:
            note += ': is it an angle of the road wheels? Then unit = "deg" instead'
    elif low > 0 and 0.3 < np.median(values) < 0.7:
        settings, note = _scaled(0.5, 0.5), "0..1 read as -1..1"
    return Entry(guess, wrap | settings, note)


def _is_angle(steer: _Scalar) -> bool:
    unit = steer.guess.unit
    return steer.guess.channel == "steer_angle" or bool(unit and channel_unit("steer_angle", unit) is not None)


def _road_unit(steer: _Scalar) -> str:
    """Return the unit of a road wheel angle; "" if it is too large or is the steering wheel's."""
    guess = steer.guess
    names = (guess.topic, *guess.fields, *(parse_label(name).name for name in guess.fields))
    if guess.is_handwheel or is_named("steering_wheel", *names):
        return ""
    units = [channel_unit("steer_angle", guess.unit) or "rad"] if guess.unit else ["rad", "deg"]
    return next((unit for unit in units if 0 < steer.largest * ANGLES[unit] <= RANGES["widest"]), "")
