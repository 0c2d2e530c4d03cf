"""Checks of single signals: non-finite values, constant channels, spikes and wrapped counters."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

from offpiste.core.channels import control_of
from offpiste.inspection.findings import EXCHANGED, Finding, Severity, of_one_cause
from offpiste.inspection.ranges import is_untouched, limits
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.signal_faults import (
    COUNTED_DEGREES,
    MAX_SPIKES,
    are_off_the_earth,
    degrees_each,
    find_spikes,
    find_wrap,
    is_clock,
    unrolled,
)
from offpiste.inspection.usual_ranges import scaled_to_unit
from offpiste.logs.channel import LARGEST, between_samples, convert, largest_recorded, unwrapped
from offpiste.rig.channels import GEOGRAPHIC, POSE, ChannelSource, Wrap, known_channels
from offpiste.rig.edits import Edit, absent, rounded, toml_value
from offpiste.rig.rig import Rig

_MOST_LEFT = 0.5
"""Maximum share of spikes that may remain within the proposed range of valid values."""


@dataclass(frozen=True)
class Signal:
    """Time series of one scalar.

    Attributes:
        where: name shown to users.
        key: rig entry that reads the signal, e.g. "channels.throttle"; "" if none does.
        raw: recorded values, unwrapped as defined in the rig.
        values: values converted by the rig, without invalid ones; equal to `raw` without a rig.
        range: limits of the channel, if any.
        largest: maximum recorded magnitude of a measurement.
        beside: usual minimum and maximum of the channel's other components, as one valid range applies to all.
    """

    where: str
    key: str
    raw: Float[np.ndarray, " n"]
    values: Float[np.ndarray, " m"]
    range: tuple[float, float] | None = None
    largest: float = LARGEST
    beside: tuple[float, float] = (np.inf, -np.inf)

    def cure(self, entry: str, value: object) -> tuple[str, tuple[tuple[Edit, ...], ...]]:
        """Return a remedy that sets one entry of the channel, as text and edits; no edits if no channel reads it."""
        if not self.key:
            return f"where a channel reads it: {entry} = {toml_value(value)}", ()
        edit = Edit(f"{self.key}.{entry}", value)
        return str(edit), ((edit,),)


def other_signals(recorded: dict[str, Recorded], rig: Rig | None) -> list[Signal]:
    """Return all recorded fields that no channel of the rig reads."""
    read = {(source.topic, field) for source in (rig.channels.values() if rig else ()) for field in source.fields}
    return [
        Signal(field_in_words(topic, field), "", column, column)
        for topic, r in recorded.items()
        for field, column in zip(r.fields, r.values.T, strict=True)
        if (topic, field) not in read and not is_clock(column)
    ]


def channel_signals(recorded: dict[str, Recorded], rig: Rig) -> list[Signal]:
    """Return all components of the rig's channels after conversion."""
    signals = []
    for name, source in rig.channels.items():
        r = recorded.get(source.topic)
        if r is None or not set(source.fields) <= set(r.fields):
            continue
        columns = r.values[:, [r.fields.index(f) for f in source.fields]]
        converted = _valid(convert(name, source, columns, rig.vehicle), source)
        raw = columns if source.wrap is None else unwrapped(columns, source.wrap)
        for i, field in enumerate(source.fields[: converted.shape[1]]):
            where = f"{name} ({field_in_words(source.topic, field)})"
            most = largest_recorded(name, source, i, rig.vehicle)
            beside = _usual(np.delete(converted, i, axis=1))
            signals.append(Signal(where, f"channels.{name}", raw[:, i], converted[:, i], limits(name), most, beside))
    return signals


def check_signals(signals: list[Signal], rig: Rig | None) -> list[Finding]:
    """Return findings on each signal, as notes if no channel reads it.

    Args:
        rig: rig whose channels read the signals.
    """
    findings, dead = _other_than_degrees(signals, rig), list[Signal]()
    counted = {where for finding in findings for where in finding.where.split(", ")}
    findings += of_one_cause([f for signal in signals if signal.where not in counted for f in _not_finite(signal)])
    for signal in signals:
        raw = signal.raw[np.abs(np.nan_to_num(signal.raw, nan=np.inf)) <= signal.largest]
        if len(raw) < 10:
            continue
        control = control_of(signal.key.removeprefix("channels."))
        if control is not None and control.discrete:
            continue  # discrete controls are constant and jump
        if np.ptp(raw) == 0:
            dead.append(signal)
            continue
        wrap = find_wrap(raw)
        if wrap is not None:
            findings.append(_wrapped(signal, raw, wrap))
        else:
            findings += _spiked(signal)
    return findings + _dead(dead, rig)


def _other_than_degrees(signals: list[Signal], rig: Rig | None) -> list[Finding]:
    """Return findings on latitude and longitude read as degrees but recorded in another unit or swapped."""
    source = rig.channels.get("position") if rig else None
    if source is None or source.unit != GEOGRAPHIC or source.scale != 1:
        return []
    both = [signal for signal in signals if signal.key == "channels.position"][:2]
    if len(both) < 2:
        return []
    evidence = f"around ({np.nanmedian(both[0].raw):.7g}, {np.nanmedian(both[1].raw):.7g}), read in degrees"
    if (each := degrees_each(*(signal.raw for signal in both))) == 1:
        if not are_off_the_earth(*(signal.raw for signal in both)):
            return []
        if not are_off_the_earth(*(signal.raw for signal in reversed(both))):
            x, y, *height = source.fields
            swap = Edit("channels.position.fields", [y, x, *height])
            return [Finding("fatal", "position", EXCHANGED, evidence, str(swap), 1.0, ((swap,),))]
        how = "convert to degrees: of minutes, 60 are one; 4724.36 may be 47 degrees, 24.36 minutes; in .vbo west is +"
        return [Finding("fatal", ", ".join(s.where for s in both), "is not in degrees", evidence, how, 1.0)]
    cure = (Edit("channels.position.scale", each), Edit("channels.position.fields", list(source.fields[:2])))
    what = "is counted in ten-millionths of a degree" if each == COUNTED_DEGREES else "is in radians"
    how = f"{', '.join(map(str, cure))}: a height would be scaled, too"
    return [Finding("fatal", signal.where, what, evidence, how, 1.0, (cure,)) for signal in both]


def field_in_words(topic: str, field: str) -> str:
    """Return the displayed name of a field: `controls[1]`, `/odom pose.position.x`, or the column name of a table."""
    if not topic:
        return field
    return f"{topic}[{field}]" if field.isdigit() else f"{topic} {field}"


def _not_finite(signal: Signal) -> list[Finding]:
    with np.errstate(invalid="ignore"):
        bad = ~(np.abs(signal.raw) <= signal.largest)
    empty = between_samples(np.isnan(signal.raw))
    bad &= ~empty
    if not bad.any():
        return []
    count = int((~empty).sum())
    share = float(bad.sum() / count)
    how = "nothing where the rest is enough: those samples are dropped on reading"
    name = signal.key.removeprefix("channels.")
    if not name:
        how = "nothing: no channel reads it"
    elif share >= 0.5:
        how = f'declare it absent: absent = ["{name}"]'
        if name in (*POSE, "steer"):
            how = "take another field; where the rest comes often enough, nothing: those samples are dropped on reading"
    at = np.flatnonzero(bad)
    evidence = f"{len(at)} of {count} samples ({share:.1%}), the first {at[0]}, the last {at[-1]}"
    severity: Severity = "warning" if signal.key else "note"
    return [Finding(severity, signal.where, "values are NaN, infinite or beyond any measurement", evidence, how, share)]


def _wrapped(signal: Signal, raw: Float[np.ndarray, " n"], wrap: Wrap) -> Finding:
    count = int((raw > wrap.above).sum())
    remedy, cures = signal.cure("wrap", {"above": rounded(wrap.above), "period": wrap.period})
    return Finding(
        "warning" if signal.key else "note",
        signal.where,
        "wraps around like a 16-bit counter below zero",
        f"{count} of {len(raw)} samples ({count / len(raw):.1%}) lie between {raw[raw > wrap.above].min():g} and "
        f"{raw.max():g}, the others below {raw[raw <= wrap.above].max():g}",
        remedy,
        count / len(raw),
        cures,
    )


def _spiked(signal: Signal) -> list[Finding]:
    values = unrolled(signal.values[np.isfinite(signal.values)])
    spikes = find_spikes(values)
    if not spikes.any():
        return []
    usual, at = values[~spikes], values[spikes]
    low, high = _limits(usual, at) if signal.range is None else _around(signal.range)
    low, high = min(low, signal.beside[0]), max(high, signal.beside[1])
    # A quick press stays within the pedal's range, and a bump within twice the usual span of rates.
    floor, ceiling = float(usual.min()), float(usual.max())
    room = ceiling - floor
    if signal.range is not None:
        room = (signal.range[1] - signal.range[0]) / 4
        floor, ceiling = min(floor, signal.range[0]), max(ceiling, signal.range[1])
    if at.max() < ceiling + room and at.min() > floor - room:
        return []
    inside = int(((at >= low) & (at <= high)).sum())
    remedy, cures = signal.cure("valid", [rounded(low), rounded(high)])
    lost = float(np.mean((usual < low) | (usual > high)))
    if inside > _MOST_LEFT * len(at) or lost > MAX_SPIKES:
        remedy, cures, inside = "no range of valid values parts them from the others: take another field", (), 0
    return [
        Finding(
            "warning" if signal.key else "note",
            signal.where,
            "isolated spikes",
            f"{spikes.sum()} of {len(values)} samples, between {at.min():.4g} and {at.max():.4g} where the others "
            f"lie between {usual.min():.4g} and {usual.max():.4g}",
            remedy + (f", which removes all but {inside}" if inside else ""),
            float(spikes.mean()),
            cures,
        )
    ]


def _usual(others: Float[np.ndarray, "n k"]) -> tuple[float, float]:
    """Return the usual range of components without spikes, extended by half its span; (inf, -inf) for no components."""
    finite = [column[np.isfinite(column)] for column in others.T if np.isfinite(column).any()]
    known = [median_filter(column, 7, mode="mirror") for column in finite]
    ends = [np.percentile(column, (0.1, 99.9)).tolist() for column in known]
    least = min((low - (high - low) / 2 for low, high in ends), default=np.inf)
    return least, max((high + (high - low) / 2 for low, high in ends), default=-np.inf)


def _around(limits: tuple[float, float]) -> tuple[float, float]:
    """Return a channel's range extended by 5 % on both sides, as values inside may be real."""
    room = (limits[1] - limits[0]) / 20
    return limits[0] - room, limits[1] + room


def _limits(usual: Float[np.ndarray, " n"], spikes: Float[np.ndarray, " k"]) -> tuple[float, float]:
    """Return the usual range extended by up to half its span on both sides, excluding spikes."""
    low, high = float(usual.min()), float(usual.max())
    room = (high - low) / 2
    above, below = spikes[spikes > high], spikes[spikes < low]
    top = high + min([room, *(above - high) / 2])
    bottom = low - min([room, *(low - below) / 2])
    return (0.0 if bottom < 0 <= low else bottom), top


def _dead(signals: list[Signal], rig: Rig | None) -> list[Finding]:
    scalars = [name for name, (_, widths) in known_channels().items() if widths == (1,) and name != "yaw"]
    read = [s for s in signals if s.key.removeprefix("channels.") in scalars]
    other = [s for s in signals if not s.key]
    untouched = [is_untouched(s.key.removeprefix("channels."), s.values) for s in read]
    findings = [
        Finding(
            "warning",
            s.where,
            "never changes",
            f"{s.raw[np.isfinite(s.raw)][0]:g} in all {len(s.raw)} samples",
            ", ".join(map(str, absent(s.key.removeprefix("channels."), rig))) if rig else "declare it absent",
            1.0,
            (absent(s.key.removeprefix("channels."), rig),) if rig else (),
        )
        for s, resting in zip(read, untouched, strict=True)
        if not resting
    ]
    if rig is not None:
        findings += [_never_pressed(s, rig) for s, resting in zip(read, untouched, strict=True) if resting]
    if other:
        findings.append(
            Finding(
                "note",
                "fields",
                "never change",
                f"{len(other)}: " + ", ".join(s.where for s in other[:12]) + (", ..." if len(other) > 12 else ""),
                "do not feed channels from them",
                0.0,
            )
        )
    return findings


def _never_pressed(signal: Signal, rig: Rig) -> Finding:
    """Return a note on an unused brake, which other logs of the vehicle may use."""
    name, pressed = signal.key.removeprefix("channels."), bool(signal.values[0] > 0.5)
    how = "nothing where nobody braked: the channel stays"
    if pressed:
        turned = ", ".join(map(str, scaled_to_unit(name, rig.channels[name], (0.0, 1.0), turned=True)))
        how = f"if nobody braked, it is the wrong way round: {turned}"
    evidence = f"{signal.raw[np.isfinite(signal.raw)][0]:g} in all {len(signal.raw)} samples"
    what = "stays where it is fully pressed" if pressed else "is never pressed"
    return Finding("note", signal.where, what, evidence, how, 0.0)


def _valid(values: Float[np.ndarray, "n k"], source: ChannelSource) -> Float[np.ndarray, "m k"]:
    if source.valid is None:
        return values
    with np.errstate(invalid="ignore"):
        return values[((values >= source.valid[0]) & (values <= source.valid[1])).all(axis=1)]
