"""Checks of the stamps of topics: rate, gaps, losses, order and spans, and topics that are published on change."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.core.channels import control_of
from offpiste.inspection.clocks import RECEIVE, other_origin
from offpiste.inspection.findings import Cure, Finding, Severity, fixable, merged
from offpiste.inspection.recorded_log import Recorded, beginning, rising
from offpiste.logs.channel import LEAST_KEPT
from offpiste.logs.log import Samples
from offpiste.rig.channels import OTHER_CHANNELS, SECONDS_PER_UNIT, ChannelSource, Clock
from offpiste.rig.edits import Edit
from offpiste.rig.labels import unit_by_rate
from offpiste.rig.rig import Rig

MISSING: Final = "samples are missing"
ON_CHANGE: Final = "is published only when it changes"
_SINGLE: Final = 0.25
"""Minimum share of single-period intervals; up to three in four samples may be lost at random."""
_LATE: Final = 2.0
"""Minimum time by which a reported topic starts after the pose or ends before it [s]."""
_ZONE: Final = 900.0
"""Resolution of time zone offsets [s]."""
_REPEATED, _GAPS, _LOST = 0.05, 0.02, 0.1
"""Shares of repeated stamps, of time in gaps and of lost samples above which findings are warnings."""
_DISORDER: Final = 0.2
"""Share of backward steps above which the finding is fatal."""
_SHUFFLED: Final = 0.002
"""Share of backward steps above which sorting by stamp is offered."""
_NEW: Final = 0.98
"""Minimum share of samples that differ from the previous sample in a topic published on change."""
_FEW, _SILENCES, _SILENT = 30, 5, 0.05
"""Minimum number of its samples and of its silences, and minimum share of time in silences."""
_JUMP: Final = 3.0
"""Maximum ratio of the change across silences to the usual change; lost samples cause larger changes."""
_DROPPED: Final = "no action needed: those samples are dropped on reading"


@dataclass(frozen=True)
class Timing:
    """Statistics of a topic's stamps.

    Attributes:
        rate: samples per second excluding losses and gaps [Hz]; NaN for fewer than three samples.
        jitter: half the spread from the 5th to the 95th percentile of the intervals, divided by the sample interval.
        lost: share of samples missing at this rate, excluding gaps.
        repeated, backward: number of stamps equal to, or earlier than, the previous one.
        start, end, gaps: statistics of the stamps kept on reading [s]; gaps are (start, length) of intervals longer
            than the clock's `max_gap` and ten times the sample interval.
        dropped: number of stamps dropped on reading as they repeat or go back.
    """

    start: float
    end: float
    count: int
    rate: float
    jitter: float
    lost: float
    repeated: int
    backward: int
    gaps: tuple[tuple[float, float], ...]
    dropped: int


def timing(time: Float[np.ndarray, " n"], *, max_gap: float) -> Timing:
    """Return statistics of stamps [s], ignoring non-finite ones."""
    time = time[np.isfinite(time)]
    step = np.diff(time)
    forward = step[step > 0]
    kept = rising(time)
    start, end = (float(kept[0]), float(kept[-1])) if len(kept) else (np.nan, np.nan)
    repeated, backward, dropped = int((step == 0).sum()), int((step < 0).sum()), len(time) - len(kept)
    if len(forward) < 2:
        return Timing(start, end, len(time), np.nan, 0.0, 0.0, repeated, backward, (), dropped)
    low, typical, high = np.percentile(forward, (5, 50, 95))
    # For samples in bunches or at irregular times, only the mean gives the rate; otherwise losses would bias it.
    short = forward[forward <= max(max_gap, 10 * typical)]
    lost = _lost(short / typical) if repeated < 0.02 * len(time) else None
    if lost is None and repeated == 0 and (more := _lost_half(short)) is not None:
        typical, lost = more
    single = forward[np.round(forward / typical) == 1]
    interval = float(np.mean(single if lost is not None else step[(step >= 0) & (step <= max(max_gap, 10 * typical))]))
    step = np.diff(kept)
    gaps = tuple((float(kept[i]), float(step[i])) for i in np.flatnonzero(step > max(max_gap, 10 * interval)))
    jitter = (high - low) / 2 / interval
    return Timing(start, end, len(time), 1 / interval, jitter, lost or 0.0, repeated, backward, gaps, dropped)


def _lost(periods: Float[np.ndarray, " n"]) -> float | None:
    """Return the share of missing samples from intervals in periods; None if these are not integers."""
    whole = np.round(periods)
    # The interval between duplicate messages is not a period: a loss of three in four samples is implausible.
    if len(periods) < 50 or np.mean(np.abs(periods - whole)) > 0.1 or np.mean(periods) > 1 / _SINGLE:
        return None
    return float(np.sum(whole - 1) / max(np.sum(whole), 1))


def _lost_half(interval: Float[np.ndarray, " n"]) -> tuple[float, float] | None:
    """Return the period [s] and share lost if the median interval exceeds one period due to losses."""
    for period in (np.median(interval) / 2, np.median(interval) / 3):
        lost = _lost(interval / period)
        # Stamps with a coarse clock are integer multiples of its tick as well, but rarely one tick apart.
        if lost is not None and np.mean(np.round(interval / period) == 1) > _SINGLE:
            return float(period), lost
    return None


def check_stamps(
    recorded: Mapping[str, Recorded],
    clock: Clock,
    *,
    used: Collection[str],
    silent: Collection[str] = (),
    channels: Mapping[str, ChannelSource] | None = None,
) -> list[Finding]:
    """Return findings on the stamps of each topic.

    Args:
        channels: channels of the rig, whose samples count separately if rows of a topic hold different sensors.
        used: topics that a rig reads; findings on others are notes.
        silent: topics that are published only on change, so that silence is neither gap nor loss.
    """
    findings: list[Finding] = []
    origin = beginning(recorded)
    for name, topic in recorded.items():
        where, seen = name or "table", timing(topic.time, max_gap=clock.max_gap)
        readers = [_complete(topic, s) for s in (channels or {}).values() if s.topic == name and topic.has(s)]
        found = _order(where, topic, seen, origin, clock) + _repeats(where, topic, seen, clock, readers)
        found += [] if name in silent else _intervals(where, seen, origin, clock, used=name in used)
        findings += found if name in used else [replace(f, severity="note") for f in found]
    return merged(findings)


def _complete(topic: Recorded, source: ChannelSource) -> Samples:
    """Return the rows that hold all fields of a channel."""
    values = topic.columns(source)
    known = np.isfinite(topic.time) & np.isfinite(values).all(axis=1)
    return Samples(topic.time[known], values[known])


def _arrivals(topic: Recorded, clock: Clock) -> Float[np.ndarray, " n"] | None:
    """Return the arrival times of a topic if they are in order and can replace its header stamps; otherwise None."""
    if topic.other is None or clock.stamps != "header" or len(topic.other) < 2:
        return None
    return topic.other if np.mean(np.diff(topic.other) > 0) > 0.99 else None


def _order(where: str, topic: Recorded, seen: Timing, origin: float, clock: Clock) -> list[Finding]:
    """Return findings on stamps that are not finite or go back."""
    findings, total, arrives = [], len(topic.time), _arrivals(topic, clock)
    cures: tuple[Cure, ...] = () if arrives is None else ((RECEIVE,),)
    if seen.count < total:
        evidence, share = f"{total - seen.count} of {total}", 1 - seen.count / total
        what = "stamps are not finite"
        findings.append(fixable("warning", where, what, evidence, *cures, score=share, advice=_DROPPED))
    if not seen.backward:
        return findings
    with np.errstate(invalid="ignore"):  # infinite stamps
        step = np.diff(topic.time)
    worst, share = int(np.nanargmin(step)), seen.backward / total
    evidence = f"{seen.backward} of {total}; by {-step[worst]:.3f} s at {topic.time[worst] - origin:.2f} s; "
    evidence += f"reading drops {seen.dropped} of {total} samples"
    what = "stamps go back"
    severity: Severity = "fatal" if share > _DISORDER else "warning"
    late = arrives is not None and not _clock_was_set_back(topic.time, arrives)
    if share > _SHUFFLED and not clock.sort:
        sort = (Edit("clock.sort", True),)
        cures = (sort, *cures) if late else (*cures, sort)
        what = "samples are not in the order of their stamps" if share > _DISORDER else what
    elif late:  # arrival times would add delays to all samples to fix a few late ones
        cures, severity = (), "note"
    score = seen.dropped / total
    return [*findings, fixable(severity, where, what, evidence, *cures, score=score, advice=_DROPPED)]


def _clock_was_set_back(time: Float[np.ndarray, " n"], arrives: Float[np.ndarray, " n"]) -> bool:
    """Return whether the lag behind arrivals increases after a backward step, rather than for single late samples."""
    late, back = arrives - time, np.flatnonzero(np.diff(time) < 0)
    return any(
        np.nanmedian(late[at + 1 : at + 21]) - np.nanmedian(late[max(at - 19, 0) : at + 1])
        > (time[at] - time[at + 1]) / 2
        for at in back[:100]
    )


def _repeats(where: str, topic: Recorded, seen: Timing, clock: Clock, readers: Sequence[Samples]) -> list[Finding]:
    """Return a finding if stamps repeat in a channel, or in a topic that no channel reads.

    Args:
        readers: samples that each channel reads.
    """
    repeated = max((int((np.diff(samples.time) == 0).sum()) for samples in readers), default=seen.repeated)
    if not repeated:
        return []
    share, arrives = repeated / len(topic.time), _arrivals(topic, clock) is not None
    evidence = f"{repeated} of {len(topic.time)} ({share:.1%})"
    if topic.copies:
        how = "no action needed: they are copies of the sample before, and one of each is kept"
        return [Finding("note", where, "stamps repeat", evidence, how, share)]
    if not arrives and not seen.backward and any(map(_refused, readers)):
        kept = len(topic.rising)
        evidence += f": {len(topic.time) / kept:.2g} samples for each"
        if kept > 1:
            evidence += f", of which there are {(kept - 1) / (seen.end - seen.start):.3g} a second"
        how = "take another clock.column; or export the stamps with all their decimals, or one row for each"
        return [Finding("fatal", where, "stamps repeat", evidence, how, share)]
    how = _DROPPED if share <= 0.02 else "no action needed: one sample a stamp is kept"
    severity: Severity = "warning" if share > _REPEATED else "note"
    cures = ((RECEIVE,),) if arrives else ()
    return [fixable(severity, where, "stamps repeat", evidence, *cures, score=share, advice=how)]


def _refused(samples: Samples) -> bool:
    """Return whether reading rejects a channel because too many different samples share a stamp."""
    copies = (np.diff(samples.time) == 0) & (np.diff(samples.values, axis=0) == 0).all(axis=1)
    return len(np.unique(samples.time)) < LEAST_KEPT * (len(samples.time) - copies.sum())


def _intervals(where: str, seen: Timing, origin: float, clock: Clock, *, used: bool) -> list[Finding]:
    """Return findings on the unit of stamps, gaps and lost samples; unordered stamps have no rate."""
    if not np.isfinite(seen.rate) or seen.backward > _DISORDER * seen.count:
        return []
    seconds = seen.end - seen.start
    unit = unit_by_rate(seen.rate, clock.unit, seen.start / SECONDS_PER_UNIT[clock.unit])
    if used and seen.count > 20 and unit != clock.unit:
        evidence = f"{seen.rate:.3g} samples a second, {seconds:.3g} s long"
        return [fixable("fatal", where, "stamps are in another unit", evidence, (Edit("clock.unit", unit),))]
    findings = []
    if 1 / seen.rate > clock.max_gap and used:
        edit = Edit("clock.max_gap", float(np.ceil(20 / seen.rate) / 10))
        evidence = f"one sample in {1 / seen.rate:.2f} s, clock.max_gap is {clock.max_gap} s"
        what, how = "is slower than the longest gap that is interpolated", f"{edit}; or use another topic"
        findings.append(Finding("warning", where, what, evidence, how, 1.0, ((edit,),)))
    # Topics without a steady rate are published on events, so their silence is no gap.
    elif seen.gaps and (used or seen.jitter < 0.5):
        at, longest = max(seen.gaps, key=lambda gap: gap[1])
        share = sum(length for _, length in seen.gaps) / seconds
        what = "has gaps" if len(seen.gaps) > 1 else "has a gap"
        evidence = f"{len(seen.gaps)}, the longest {longest:.2f} s at {at - origin:.2f} s; {share:.1%} of the time"
        how = "no action needed if enough data remains: the drive is cut there (clock.max_gap)"
        findings.append(Finding("warning" if share > _GAPS else "note", where, what, evidence, how, share))
    if seen.lost > 0.02:
        evidence = f"{seen.lost:.1%} at a rate of {seen.rate:.1f} Hz"
        how = "record with a larger queue; short holes are interpolated"
        findings.append(Finding("warning" if seen.lost > _LOST else "note", where, MISSING, evidence, how, seen.lost))
    return findings


def check_spans(
    recorded: Mapping[str, Recorded],
    pose: str,
    clock: Clock,
    *,
    used: bool,
    channels: Mapping[str, ChannelSource] | None = None,
    silent: Collection[str] = (),
) -> list[Finding]:
    """Return findings for topics that do not overlap or cover the pose's time span, and vice versa.

    Args:
        channels: channels of the rig, whose delays shift their topics.
        silent: topics whose last sample remains valid to the end.
    """
    channels = channels or {}
    delays = {source.topic: source.delay for source in channels.values()}
    span, others, findings = _span(recorded[pose], delays), {}, list[Finding]()
    for name, topic in recorded.items():
        if name == pose or np.isfinite(topic.time).sum() < 3:
            continue
        own = others[name] = _span(topic, delays)
        if (origin := other_origin(recorded, name, pose, clock, used=used or name in delays)) is not None:
            findings.append(origin)
        elif own[1] < span[0] or own[0] > span[1]:
            delayed = {key: source for key, source in channels.items() if source.topic == name}
            cure = (RECEIVE,) if topic.other is not None else _by_delays(delayed, own[0] - span[0])
            what, how = f"its clock does not overlap that of {pose}", "drop the topic, or fix its stamps"
            evidence = f"{own[0]:.2f} to {own[1]:.2f} s against {span[0]:.2f} to {span[1]:.2f} s"
            findings.append(fixable("fatal" if used else "note", name, what, evidence, cure, advice=how))
        else:
            others[name] = (own[0], max(own[1], span[1])) if name in silent else own
            findings += _part_of(name, others[name], span, pose, used=used)
    # If several topics agree on a longer drive, the pose stops early.
    if len(others) > 1:
        start, end = np.median(list(others.values()), axis=0).tolist()
        if start <= span[1] and end >= span[0]:
            findings += _part_of(pose, span, (start, end), "the other topics", used=used)
    return findings


def _by_delays(channels: Mapping[str, ChannelSource], apart: float) -> Cure:
    """Return delays that align the start of channels with the pose, or that correct a time zone offset."""
    zones = round(apart / _ZONE) * _ZONE
    apart = zones if abs(apart - zones) < _LATE else apart
    return tuple(Edit(f"channels.{name}.delay", round(source.delay + apart, 3)) for name, source in channels.items())


def _part_of(
    name: str, own: tuple[float, float], span: tuple[float, float], whose: str, *, used: bool
) -> list[Finding]:
    """Return a finding if a topic covers only a part of another time span."""
    late, early = max(own[0] - span[0], 0.0), max(span[1] - own[1], 0.0)
    if max(late, early) <= _LATE:
        return []
    share = (late + early) / (span[1] - span[0])
    evidence = f"{late:.1f} s after the start and {early:.1f} s before the end of {whose}: {share:.0%} of it"
    how = "no action needed if enough data remains: those rows are left out"
    severity: Severity = "warning" if used and share > 0.1 else "note"
    return [Finding(severity, name, "starts late or stops early", evidence, how, share)]


def _span(topic: Recorded, delays: Mapping[str, float]) -> tuple[float, float]:
    time = topic.rising - delays.get(topic.topic.name, 0.0)
    return (float(time[0]), float(time[-1])) if len(time) else (np.nan, np.nan)


def check_on_change(recorded: Mapping[str, Recorded], rig: Rig) -> list[Finding]:
    """Return a finding for each control or actuator topic that is silent while its values are constant."""
    findings = []
    for topic, r in recorded.items():
        reads = {name: source for name, source in rig.channels.items() if source.topic == topic}
        changing = [name for name, source in reads.items() if source.interpolation != "on change"]
        measured = any(name in OTHER_CHANNELS for name in reads)
        if not changing or measured or not np.isfinite(r.time).all():
            continue
        step, new = np.diff(r.time), _changed(r)
        silence = step > rig.clock.max_gap
        if new < _NEW or not _is_silent_while_constant(r, reads, step, silence):
            continue
        share = float(step[silence].sum() / max(step.sum(), 1e-9))
        evidence = f"{len(r.time)} samples, {new:.0%} of them new; {silence.sum()} times it is silent for more "
        evidence += f"than {rig.clock.max_gap:g} s, {share:.0%} of the time"
        cure = tuple(Edit(f"channels.{name}.interpolation", "on change") for name in changing)
        findings.append(fixable("warning", topic or "table", ON_CHANGE, evidence, cure, score=share))
    return findings


def _is_silent_while_constant(
    r: Recorded, reads: Mapping[str, ChannelSource], step: Float[np.ndarray, " n"], silence: Bool[np.ndarray, " n"]
) -> bool:
    """Return whether a topic is silent often, and no value jumps after a silence, unlike after lost samples."""
    if all((control := control_of(name)) is not None and control.discrete for name in reads):
        return bool(silence.all())
    often = len(r.time) >= _FEW and silence.sum() >= _SILENCES and step[silence].sum() >= _SILENT * step.sum()
    if not often or not (step > 0).all():
        return False
    fields = {field for source in reads.values() for field in source.fields}
    values = r.values[:, [field in fields for field in r.fields]]
    values = values[:, np.ptp(values, axis=0) > 0]
    if not values.shape[1]:
        return False
    change = (np.abs(np.diff(values, axis=0)) / np.ptp(values, axis=0)).max(axis=1)
    usual = change[~silence & (change > 0)]
    return bool(len(usual)) and bool(np.median(change[silence]) <= _JUMP * np.median(usual))


def _changed(r: Recorded) -> float:
    """Return the share of samples that differ from the previous one, ignoring times and counters."""
    steps = np.diff(r.values[:, np.isfinite(r.values).all(axis=0)], axis=0)
    if not len(steps):
        return 1.0
    grow = (steps >= 0).all(axis=0) & ((steps > 0).mean(axis=0) > 0.5) & (len(steps) > 2)
    return float((steps[:, ~grow] != 0).any(axis=1).mean())
