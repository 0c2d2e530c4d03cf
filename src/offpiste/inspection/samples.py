"""Defects of channels as recorded: values that are not finite, dead fields, wraps, spikes, and other ranges.

`_DEFECTS` lists the defects of single signals, and `_FIXES` the explanations of values outside a channel's range.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import msgspec
import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import find_objects, label, median_filter

from offpiste.core.channels import all_actuators, all_controls, control_of
from offpiste.core.errors import RigError
from offpiste.inspection.findings import Cure, Finding, Severity, found, of_one_cause
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.signal_faults import (
    COUNTED_DEGREES,
    MAX_SPIKES,
    PERIODS,
    are_off_the_earth,
    degrees_each,
    find_spikes,
    find_wrap,
    is_clock,
    unrolled,
)
from offpiste.inspection.usual_ranges import (
    full_scale,
    is_signed,
    rests_high,
    scaled_to_unit,
    steering_middle,
    whole_range,
)
from offpiste.logs.channel import LARGEST, between_samples, convert, largest, largest_recorded, unwrapped
from offpiste.rig.channels import GEOGRAPHIC, POSE, ChannelSource, known_channels, unit_factor
from offpiste.rig.edits import Edit, absent, rescaled, rounded, toml_value
from offpiste.rig.rig import Rig

BRAKES: Final = ("brake", "brake_pressure")
"""Channels that are constant in a log without braking."""
_AT_AN_END: Final = 0.15
"""Maximum distance of an unused brake from 0 or 1; some rest slightly above 0."""
_MOST_LEFT: Final = 0.5
"""Maximum share of spikes that may remain within the proposed range of valid values."""
_ALTERNATIVES: Final = {"percent": 0.01, "permille": 0.001, "deg": np.pi / 180, "rev/min": 0.001}
"""Units in which controls and actuators are often recorded."""
_CLIPPED, _CUT = 0.2, 0.05
"""Maximum shares of samples that a rig may clip, for pedals (at rest) and for controls with two ends."""
_BEYOND: Final = 0.025
"""Minimum excess of a clipped two-ended control, as a share of its range."""
_LARGER: Final = 2.0
"""Minimum ratio of a step into invalid values to the 99.5th percentile of the steps between valid ones."""
_DROPPED: Final = 0.005
"""Minimum reported share of measurements dropped by `valid`."""


@dataclass(frozen=True)
class Signal:
    """Time series of one scalar.

    Attributes:
        where: name shown to users.
        channel: channel that reads the signal; "" if none does.
        raw: recorded values, unwrapped as defined in the rig.
        values: values converted by the rig, without invalid ones; equal to `raw` if no channel reads the signal.
        unclipped: plausible ones of these before the rig clips them.
        rig: rig with the channel.
        largest: maximum recorded magnitude of a measurement.
        others: converted values of the channel's other components, as one valid range applies to all.
    """

    where: str
    channel: str
    raw: Float[np.ndarray, " n"]
    values: Float[np.ndarray, " m"]
    unclipped: Float[np.ndarray, " k"]
    rig: Rig | None = None
    largest: float = LARGEST
    others: Float[np.ndarray, "m c"] | None = None

    @property
    def known(self) -> Float[np.ndarray, " k"]:
        """Recorded values that may be measurements."""
        return self.raw[np.abs(self.raw) <= self.largest]

    @property
    def severity(self) -> Severity:
        """Severity of a defect: "note" if no channel reads the signal."""
        return "warning" if self.channel else "note"

    def fixed(self, code: str, about: Mapping[str, Any], share: float, entry: str, value: object) -> Finding:
        """Return a finding that one entry of the channel fixes, which is advice if no channel reads the signal."""
        cure = (Edit(f"channels.{self.channel}.{entry}", value),) if self.channel else ()
        about = {**about, "entry": f"{entry} = {toml_value(value)}"}
        return found(code, self.where, about, cure, severity=self.severity, score=share)


def field_in_words(topic: str, field: str) -> str:
    """Return the displayed name of a field: `controls[1]`, `/odom pose.position.x`, or the column name of a table."""
    if not topic:
        return field
    return f"{topic}[{field}]" if field.isdigit() else f"{topic} {field}"


def other_signals(recorded: Mapping[str, Recorded], rig: Rig | None) -> list[Signal]:
    """Return all recorded fields that no channel of the rig reads."""
    read = {(source.topic, field) for source in (rig.channels.values() if rig else ()) for field in source.fields}
    return [
        Signal(field_in_words(topic, field), "", column, column, column)
        for topic, r in recorded.items()
        for field, column in zip(r.fields, r.values.T, strict=True)
        if (topic, field) not in read and not is_clock(column)
    ]


def channel_signals(recorded: Mapping[str, Recorded], rig: Rig) -> list[Signal]:
    """Return all components of the rig's channels after conversion."""
    signals = []
    for name, source, columns in _read(recorded, rig):
        converted = _valid(convert(name, source, columns, rig.vehicle), source)
        unclipped = _valid(_measured(name, rig, columns), source)
        raw = columns if source.wrap is None else unwrapped(columns, source.wrap)
        for i, field in enumerate(source.fields[: converted.shape[1]]):
            where = f"{name} ({field_in_words(source.topic, field)})"
            most = largest_recorded(name, source, i, rig.vehicle)
            others = np.delete(converted, i, axis=1)
            signals.append(Signal(where, name, raw[:, i], converted[:, i], unclipped[:, i], rig, most, others))
    return signals


def check_signals(signals: Sequence[Signal], rig: Rig | None) -> list[Finding]:
    """Return findings on each signal, as notes if no channel reads it.

    Args:
        rig: rig whose channels read the signals.
    """
    findings = _other_than_degrees(signals, rig)
    counted = {where for finding in findings for where in finding.where.split(", ")}
    findings += of_one_cause([f for s in signals if s.where not in counted and (f := _not_finite(s)) is not None])
    # Discrete controls are constant and jump.
    varying = [s for s in signals if (control := control_of(s.channel)) is None or not control.discrete]
    varying = [signal for signal in varying if len(signal.known) >= 10]
    defects = (next(filter(None, (defect(signal) for defect in _DEFECTS)), None) for signal in varying)
    findings += filter(None, defects)
    dead = [signal.where for signal in varying if not signal.channel and np.ptp(signal.known) == 0]
    if dead:
        names = ", ".join(dead[:12]) + (", ..." if len(dead) > 12 else "")
        findings.append(found("dead", "fields", {"count": len(dead), "names": names}))
    return findings


def _not_finite(signal: Signal) -> Finding | None:
    bad, empty = ~(np.abs(signal.raw) <= signal.largest), between_samples(np.isnan(signal.raw))
    at, count = np.flatnonzero(bad & ~empty), int((~empty).sum())
    if not len(at):
        return None
    share, remedy = len(at) / count, "remedy"
    if not signal.channel:
        remedy = "unread"
    elif share >= 0.5:
        remedy = "needed" if signal.channel in (*POSE, "steer") else "absent"
    values = {"bad": len(at), "count": count, "first": at[0], "last": at[-1], "channel": signal.channel}
    return found("not_finite", signal.where, values, severity=signal.severity, score=share, remedy=remedy)


def _never_changing(signal: Signal) -> Finding | None:
    """Report a constant scalar channel; as a note if it is a brake, which other logs of the vehicle may use."""
    name, rig = signal.channel, signal.rig
    if rig is None or np.ptp(signal.known) > 0 or known_channels()[name][1] != (1,) or name == "yaw":
        return None
    values = {"value": signal.raw[np.isfinite(signal.raw)][0], "count": len(signal.raw)}
    if not is_untouched(name, signal.values):
        return found("constant", signal.where, values, absent(name, rig))
    if signal.values[0] <= 0.5:
        return found("never_pressed", signal.where, values)
    turned = scaled_to_unit(name, rig.channels[name], (0.0, 1.0), turned=True)
    return found("fully_pressed", signal.where, {**values, "turned": ", ".join(map(str, turned))})


def _wrapped(signal: Signal) -> Finding | None:
    raw = signal.known
    if (wrap := find_wrap(raw)) is None:
        return None
    above = raw > wrap.above
    about = {"above": above.sum(), "count": len(raw), "top": raw.max(), "low": raw[~above].max()}
    about["least"] = raw[above].min()
    entry = {"above": wrap.above, "period": wrap.period}
    return signal.fixed("wrapped", about, float(above.mean()), "wrap", entry)


def _spiked(signal: Signal) -> Finding | None:
    """Report isolated spikes."""
    values, limit = unrolled(signal.values[np.isfinite(signal.values)]), limits(signal.channel)
    spikes = find_spikes(values)
    if not spikes.any():
        return None
    usual, at = values[~spikes], values[spikes]
    # A quick press stays within the pedal's range, and a bump within twice the usual span of rates.
    ends = usual if limit is None else np.append(usual, limit)
    floor, ceiling = float(ends.min()), float(ends.max())
    room = ceiling - floor if limit is None else (limit[1] - limit[0]) / 4
    if at.max() < ceiling + room and at.min() > floor - room:
        return None
    low, high = _extended(usual, at) if limit is None else (limit[0] - room / 5, limit[1] + room / 5)
    for least, most in [] if signal.others is None else map(_usual, signal.others.T):
        low, high = min(low, least), max(high, most)
    inside, share = int(((at >= low) & (at <= high)).sum()), float(spikes.mean())
    about = {"spikes": spikes.sum(), "count": len(values), "least": at.min(), "most": at.max()}
    about |= {"low": usual.min(), "high": usual.max(), "inside": ""}
    if inside > _MOST_LEFT * len(at) or np.mean((usual < low) | (usual > high)) > MAX_SPIKES:
        return found("spikes", signal.where, about, severity=signal.severity, score=share, remedy="no_range")
    if inside:
        about["inside"] = f"; a range of valid values removes all but {inside}"
    return signal.fixed("spikes", about, share, "valid", [rounded(low), rounded(high)])


_DEFECTS: Final = (_never_changing, _wrapped, _spiked)
"""Checks of a signal; the first that reports a defect ends them."""


def _usual(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the range of values without spikes, extended by half its span; (inf, -inf) without finite values."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return np.inf, -np.inf
    low, high = np.percentile(median_filter(finite, 7, mode="mirror"), (0.1, 99.9)).tolist()
    return low - (high - low) / 2, high + (high - low) / 2


def _extended(usual: Float[np.ndarray, " n"], spikes: Float[np.ndarray, " k"]) -> tuple[float, float]:
    """Return the usual range extended by up to half its span on both sides, excluding spikes."""
    low, high = float(usual.min()), float(usual.max())
    room = (high - low) / 2
    top = high + min([room, *(spikes[spikes > high] - high) / 2])
    bottom = low - min([room, *(low - spikes[spikes < low]) / 2])
    return (0.0 if bottom < 0 <= low else bottom), top


def _other_than_degrees(signals: Sequence[Signal], rig: Rig | None) -> list[Finding]:
    """Return findings on latitude and longitude read as degrees but recorded in another unit or swapped."""
    source = rig.channels.get("position") if rig else None
    both = [signal for signal in signals if signal.channel == "position"][:2]
    if source is None or source.unit != GEOGRAPHIC or source.scale != 1 or len(both) < 2:
        return []
    raw = [signal.raw for signal in both]
    values = {"latitude": np.nanmedian(raw[0]), "longitude": np.nanmedian(raw[1])}
    x, y, *height = source.fields
    if (each := degrees_each(*raw)) != 1:
        cure = (Edit("channels.position.scale", each), Edit("channels.position.fields", [x, y]))
        code = "counted_degrees" if each == COUNTED_DEGREES else "radians"
        return [found(code, signal.where, values, cure) for signal in both]
    if not are_off_the_earth(*raw):
        return []
    if not are_off_the_earth(*reversed(raw)):
        return [found("exchanged", "position", values, (Edit("channels.position.fields", [y, x, *height]),))]
    return [found("not_degrees", ", ".join(signal.where for signal in both), values)]


def is_untouched(name: str, values: Float[np.ndarray, " n"]) -> bool:
    """Return whether a channel is a brake that stays at an end of its range, as without braking."""
    if name not in BRAKES or not len(values) or np.ptp(values) > 0:
        return False
    return bool(min(abs(values[0]), abs(values[0] - 1)) <= _AT_AN_END)


def limits(channel: str) -> tuple[float, float] | None:
    """Return the range of a control or actuator channel in offpiste's units, or None."""
    actuators = {a.channel: (a.low, a.high) for a in all_actuators() if a.low is not None and a.high is not None}
    return (actuators | {control.name: (control.low, control.high) for control in all_controls()}).get(channel)


def check_ranges(signals: Sequence[Signal]) -> list[Finding]:
    """Return findings on controls and actuators that exceed their limits or are clipped by the rig."""
    findings = []
    for signal in signals:
        name, values, limit = signal.channel, signal.unclipped, limits(signal.channel)
        if signal.rig is None or limit is None or signal.rig.channels[name].turns or len(values) < 20:
            continue
        source, (low, high), slack = signal.rig.channels[name], limit, _slack(signal.rig.channels[name], limit)
        # A released pedal may be far below 0 before clipping.
        below = values < (low - slack if low < 0 or not source.clip else -1.0)
        outside = float(np.mean(below | (values > high + slack)))
        if outside <= (0.005 if not source.clip else _CLIPPED if low == 0 else _CUT):
            continue
        first, last = np.percentile(values, (0.5, 99.5))
        cure = next(filter(None, (fix(signal, signal.rig, limit) for fix in _FIXES)), ())
        about = {"low": low, "high": high, "first": first, "last": last, "channel": name}
        findings.append(found("clipped" if source.clip else "out_of_range", name, about, cure, score=outside))
    return findings


def _slack(source: ChannelSource, limit: tuple[float, float]) -> float:
    """Return the excess over the limits of a channel that is accepted on both sides."""
    return (0.1 if limit[0] == 0 or not source.clip else _BEYOND) * (limit[1] - limit[0])


def _edits(name: str, **entries: float) -> Cure:
    """Return the edits of entries of a channel."""
    return tuple(Edit(f"channels.{name}.{key}", rounded(value)) for key, value in entries.items())


def _at_rest(signal: Signal, rig: Rig, _: tuple[float, float]) -> Cure:
    """Return the edit that shifts an unused, constant brake to zero; its scale is unknown."""
    name, source = signal.channel, rig.channels[signal.channel]
    if name not in BRAKES or np.ptp(signal.unclipped) > 0:
        return ()
    rest = float(signal.unclipped[0]) / (source.sign * unit_factor(name, source.unit))
    return _edits(name, offset=source.offset - rest)


def _permanently_negative(signal: Signal, rig: Rig, limit: tuple[float, float]) -> Cure:
    """Return the edit that unwraps a counter that stays below zero, if the result fits the range."""
    name, source = signal.channel, rig.channels[signal.channel]
    low, high = np.percentile(signal.raw[np.isfinite(signal.raw)], (0.5, 99.5))
    for period in PERIODS:
        if source.wrap is None and 0.9 * period < low <= high <= period:
            values, slack = _unclipped(name, rig, np.array([[low], [high]]) - period), _slack(source, limit)
            if (values >= limit[0] - slack).all() and (values <= limit[1] + slack).all():
                return (Edit(f"channels.{name}.wrap", {"above": period / 2, "period": period}),)
    return ()


def _whole_range(signal: Signal, rig: Rig, limit: tuple[float, float]) -> Cure:
    """Return the edits for a common raw range of a pedal without a unit, or of a steering with a positive centre."""
    name, source, values = signal.channel, rig.channels[signal.channel], signal.unclipped
    if limit[0] < 0:
        around = steering_middle(values, named=False) if not source.unit else None
        if around is None:
            return ()
        middle, reach, _ = around
        return _edits(name, scale=source.scale / reach, offset=(source.offset - source.sign * middle) / reach)
    span = whole_range(values)
    if span is None or span[1] in (1.0, 100.0, 1000.0):  # the last two have a unit
        return ()
    return scaled_to_unit(name, source, span, turned=bool(span[0] < 0 and rests_high(values)))


def _both_ways(signal: Signal, rig: Rig, limit: tuple[float, float]) -> Cure:
    """Return the edits for a signed throttle; its negative part becomes the brake if no brake channel exists."""
    source = rig.channels[signal.channel]
    if signal.channel != "throttle" or source.clip or not is_signed(signal.unclipped):
        return ()
    most = float(np.abs(np.percentile(signal.unclipped, (0.5, 99.5))).max())
    factor = 1.0 if most <= limit[1] + _slack(source, limit) else 1 / (full_scale(most) or most)
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


def _rescaled(signal: Signal, rig: Rig, limit: tuple[float, float]) -> Cure:
    """Return the edits that convert the observed range to the channel's: another unit, or scale and offset."""
    name, source, (low, high) = signal.channel, rig.channels[signal.channel], limit
    first, last = np.percentile(signal.unclipped, (0.5, 99.5)).tolist()
    extreme = max(abs(first), abs(last))
    for unit, factor in _ALTERNATIVES.items():
        if 0.3 * high < extreme * factor <= 1.2 * high and (low < 0 or first >= -0.1 * extreme):
            if source.unit or source.scale != 1.0:
                return rescaled(name, source, factor)
            with suppress(RigError):  # another unit
                unit_factor(name, unit)
                return (Edit(f"channels.{name}.unit", unit),)
    if low < 0:  # for an angle, 1 is not full lock
        return () if known_channels()[name][0] == "rad" else rescaled(name, source, high / extreme)
    if last < 0.1 * extreme and extreme <= 1.2 * high:
        return (Edit(f"channels.{name}.sign", -source.sign),)
    return scaled_to_unit(name, source, (first, last)) or absent(name, rig)


_FIXES: Final = (_at_rest, _permanently_negative, _whole_range, _both_ways, _rescaled)
"""Explanations of values outside a channel's range, as edits; the first that applies is taken."""


def check_valid(recorded: Mapping[str, Recorded], rig: Rig) -> list[Finding]:
    """Return a finding for each channel whose `valid` interval drops values continuous with their neighbours."""
    findings = []
    for name, source, columns in _read(recorded, rig):
        if source.valid is None:
            continue
        values = _measured(name, rig, columns)
        outside = np.asarray(((values < source.valid[0]) | (values > source.valid[1])).any(axis=1))
        measured = _continuing(values, outside)
        if measured.sum() <= _DROPPED * len(values):
            continue  # logs may mark unknown values
        reached = values[measured | ~outside]
        # A control's steps may hide part of its range.
        ends = np.append(reached.ravel(), limits(name) or ())
        room = np.ptp(ends) / 20
        edit = Edit(f"channels.{name}.valid", [rounded(ends.min() - room), rounded(ends.max() + room)])
        about = {"dropped": measured.sum(), "count": len(values), "least": reached.min(), "most": reached.max()}
        about |= {"low": source.valid[0], "high": source.valid[1]}
        findings.append(found("valid_drops", name, about, (edit,), score=float(measured.mean())))
    return findings


def _continuing(values: Float[np.ndarray, "n k"], outside: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return out-of-range samples in runs without larger steps into, within or out of them than valid samples have."""
    result, steps = np.zeros(len(values), bool), np.abs(np.diff(values, axis=0)).max(axis=1)
    inside = steps[~outside[1:] & ~outside[:-1]]
    if not outside.any() or not len(inside):
        return result
    large = steps > _LARGER * float(np.percentile(inside, 99.5))
    for (run,) in find_objects(label(outside)[0]):
        # Step i leads from sample i to i + 1: from the sample before the run to the one after it.
        result[run] = not large[max(run.start - 1, 0) : run.stop].any()
    return result


def _read(recorded: Mapping[str, Recorded], rig: Rig) -> list[tuple[str, ChannelSource, Float[np.ndarray, "n c"]]]:
    """Return each channel of the rig with its source and recorded columns, if the log has them."""
    there = [(name, s, r) for name, s in rig.channels.items() if (r := recorded.get(s.topic)) is not None]
    return [(name, source, r.columns(source)) for name, source, r in there if r.has(source)]


def _unclipped(name: str, rig: Rig, raw: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n c"]:
    return convert(name, msgspec.structs.replace(rig.channels[name], clip=None), raw, rig.vehicle)


def _measured(name: str, rig: Rig, raw: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "m c"]:
    """Return the converted values that may be measurements, before clipping."""
    values = _unclipped(name, rig, raw)
    return values[(np.abs(values) <= largest(name)).all(axis=1)]


def _valid(values: Float[np.ndarray, "n k"], source: ChannelSource) -> Float[np.ndarray, "m k"]:
    if source.valid is None:
        return values
    return values[((values >= source.valid[0]) & (values <= source.valid[1])).all(axis=1)]
