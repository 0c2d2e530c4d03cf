"""Check of converted channels against the range of their unit."""

from typing import Final

import msgspec
import numpy as np
from jaxtyping import Float

from offpiste.core.channels import all_actuators, all_controls
from offpiste.core.errors import RigError
from offpiste.inspection.findings import Finding
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.signal_faults import PERIODS
from offpiste.inspection.usual_ranges import (
    full_scale,
    is_signed,
    rests_high,
    scaled_to_unit,
    steering_middle,
    whole_range,
)
from offpiste.logs.channel import convert, largest
from offpiste.rig.channels import ChannelSource, known_channels, unit_factor
from offpiste.rig.edits import Edit, absent, rescaled, rounded
from offpiste.rig.rig import Rig

_ALTERNATIVES = {"percent": 0.01, "permille": 0.001, "deg": np.pi / 180, "rev/min": 0.001}
_IN_A_UNIT = (1.0, 100.0, 1000.0)
"""Full-scale values that have a unit."""
_CLIPPED, _CUT = 0.2, 0.05
"""Maximum shares of samples that a rig may clip, for pedals (at rest) and for controls with two ends."""
_BEYOND = 0.025
"""Minimum excess of a clipped two-ended control, as a share of its range."""

_SLACK = 1.1
"""Maximum of a pedal from 0 to 1, including noise."""
BRAKES: Final = ("brake", "brake_pressure")
"""Channels that are constant in a log without braking."""

_AT_AN_END: Final = 0.15
"""Maximum distance of an unused brake from 0 or 1; some rest slightly above 0."""
_TOO_FAR: Final = (
    "no road wheel turns so far: if it is the steering wheel, channels.{name}.scale is 1 over the steering's ratio"
)


def is_untouched(name: str, values: Float[np.ndarray, " n"]) -> bool:
    """Return whether a channel is a brake that stays at an end of its range, as without braking."""
    if name not in BRAKES or not len(values) or np.ptp(values) > 0:
        return False
    return bool(min(abs(values[0]), abs(values[0] - 1)) <= _AT_AN_END)


def check_ranges(recorded: dict[str, Recorded], rig: Rig) -> list[Finding]:
    """Return findings on controls and actuators that exceed their limits or are clipped by the rig."""
    findings = []
    for name, low, high in _limits():
        source = rig.channels.get(name)
        r = recorded.get(source.topic) if source else None
        if source is None or source.turns or r is None or source.fields[0] not in r.fields:
            continue
        raw = r.values[:, [r.fields.index(source.fields[0])]]
        values = _before_clip(name, rig, raw)
        if len(values) < 20:
            continue
        slack = (0.1 if low == 0 or not source.clip else _BEYOND) * (high - low)
        # A released pedal may be far below 0 before clipping.
        below = values < (low - slack if low < 0 or not source.clip else -1.0)
        outside = float(np.mean(below | (values > high + slack)))
        if outside <= (0.005 if not source.clip else _CLIPPED if low == 0 else _CUT):
            continue
        first, last = np.percentile(values, (0.5, 99.5))
        cure = _at_rest(name, source, values) or _unwrapped(name, rig, raw, (low - slack, high + slack))
        cure = cure or _of_whole_range(name, source, values, low)
        cure = cure or (_both_ways(source, values, rig) if name == "throttle" and not source.clip else ())
        cure = cure or _cure(name, source, rig, (low, high), (float(first), float(last)))
        findings.append(
            Finding(
                "warning",
                name,
                "leaves its range" if not source.clip else "is clipped much of the time",
                f"{outside:.0%} of the samples are outside of {low:g} to {high:g}; 99 % lie between {first:.3g} "
                f"and {last:.3g}",
                ", ".join(map(str, cure)) or _TOO_FAR.format(name=name),
                outside,
                (cure,) if cure else (),
            )
        )
    return findings


def limits(channel: str) -> tuple[float, float] | None:
    """Return the range of a control or actuator channel in offpiste's units, or None."""
    return next(((low, high) for name, low, high in _limits() if name == channel), None)


def _limits() -> list[tuple[str, float, float]]:
    """Return the ranges of controls and actuators by channel, in offpiste's units."""
    controls = [(control.name, control.low, control.high) for control in all_controls()]
    actuators = [(a.channel, a.low, a.high) for a in all_actuators() if a.low is not None and a.high is not None]
    return controls + actuators


def _before_clip(name: str, rig: Rig, raw: Float[np.ndarray, "n 1"]) -> Float[np.ndarray, " m"]:
    source = rig.channels[name]
    values: np.ndarray = _unclipped(name, rig, raw)[:, 0]
    values = values[np.abs(np.nan_to_num(values, nan=np.inf)) <= largest(name)]
    if source.valid is not None:
        values = values[(values >= source.valid[0]) & (values <= source.valid[1])]
    return values


def _unclipped(name: str, rig: Rig, raw: Float[np.ndarray, "n 1"]) -> Float[np.ndarray, "n 1"]:
    source = msgspec.structs.replace(rig.channels[name], clip=None)
    return convert(name, source, raw, rig.vehicle)


def _at_rest(name: str, source: ChannelSource, values: Float[np.ndarray, " n"]) -> tuple[Edit, ...]:
    """Return the edit that shifts an unused, constant brake to zero; its scale is unknown."""
    if name not in BRAKES or np.ptp(values) > 0:
        return ()
    rest = float(values[0]) / (source.sign * unit_factor(name, source.unit))
    return (Edit(f"channels.{name}.offset", rounded(source.offset - rest)),)


def _unwrapped(name: str, rig: Rig, raw: Float[np.ndarray, "n 1"], fits: tuple[float, float]) -> tuple[Edit, ...]:
    """Return the edit that unwraps a permanently negative counter; empty if the result does not fit.

    Args:
        fits: range of the unwrapped values.
    """
    low, high = np.percentile(raw[np.isfinite(raw)], (0.5, 99.5))
    for period in PERIODS:
        if rig.channels[name].wrap is not None or not 0.9 * period < low <= high <= period:
            continue
        values = _unclipped(name, rig, np.array([[low], [high]]) - period)
        if (values >= fits[0]).all() and (values <= fits[1]).all():
            return (Edit(f"channels.{name}.wrap", {"above": period / 2, "period": period}),)
    return ()


def _of_whole_range(name: str, source: ChannelSource, values: Float[np.ndarray, " n"], low: float) -> tuple[Edit, ...]:
    """Return the edits for a common raw range of a pedal, or of a steering with a positive centre.

    Returns:
        Empty for percent, which is a unit, and for other ranges.
    """
    if low < 0:
        around = steering_middle(values, named=False) if not source.unit else None
        if around is None:
            return ()
        middle, reach, _ = around
        wanted = (("scale", source.scale / reach), ("offset", (source.offset - source.sign * middle) / reach))
        return tuple(Edit(f"channels.{name}.{key}", rounded(value)) for key, value in wanted)
    span = whole_range(values)
    if span is None or span[1] in _IN_A_UNIT:
        return ()
    return scaled_to_unit(name, source, span, turned=bool(span[0] < 0 and rests_high(values)))


def _both_ways(source: ChannelSource, values: Float[np.ndarray, " n"], rig: Rig) -> tuple[Edit, ...]:
    """Return the edits for a signed throttle; its negative part becomes the brake if no brake channel exists."""
    if not is_signed(values):
        return ()
    largest = float(np.abs(np.percentile(values, (0.5, 99.5))).max())
    factor = 1.0 if largest <= _SLACK else 1 / (full_scale(largest) or largest)
    scaled = {key: rounded(factor * getattr(source, key)) for key in ("scale", "offset")}
    cure = [Edit(f"channels.throttle.{key}", value) for key, value in scaled.items() if value != getattr(source, key)]
    cure.append(Edit("channels.throttle.clip", [0.0, 1.0]))
    if "brake" not in rig.channels:
        usual = msgspec.to_builtins(ChannelSource(source.fields))
        brake = {**msgspec.to_builtins(source), **scaled, "sign": -source.sign, "clip": [0.0, 1.0]}
        stated = {key: value for key, value in brake.items() if key in ("topic", "fields") or value != usual[key]}
        cure.append(Edit("channels.brake", stated))
        if "brake" in rig.absent:
            cure.append(Edit("absent", [channel for channel in rig.absent if channel != "brake"]))
    return tuple(cure)


def _cure(
    name: str, source: ChannelSource, rig: Rig, wanted: tuple[float, float], seen: tuple[float, float]
) -> tuple[Edit, ...]:
    """Return the edits that convert the observed range to the wanted one: another unit, or scale and offset."""
    (low, high), (first, last) = wanted, seen
    extreme = max(abs(first), abs(last))
    plain = not source.unit and source.scale == 1.0
    for unit, factor in _ALTERNATIVES.items():
        if not 0.3 * high < extreme * factor <= 1.2 * high or (low == 0 and first < -0.1 * extreme):
            continue
        if not plain:
            return rescaled(name, source, factor)
        try:
            unit_factor(name, unit)
        except RigError:
            continue
        return (Edit(f"channels.{name}.unit", unit),)
    if low < 0:  # for an angle, 1 is not full lock
        return () if known_channels()[name][0] == "rad" else rescaled(name, source, high / extreme)
    if last < 0.1 * extreme and extreme <= 1.2 * high:
        return (Edit(f"channels.{name}.sign", -source.sign),)
    # Map the observed range to 0..1: value = sign * (raw * scale + offset) * unit.
    span = last - first
    if not span > 0:
        return absent(name, rig)
    scale, offset = source.scale / span, (source.offset - source.sign * first / unit_factor(name, source.unit)) / span
    return Edit(f"channels.{name}.scale", rounded(scale)), Edit(f"channels.{name}.offset", rounded(offset))
