"""Defects of a topic's stamps: order, repeats, unit, gaps, losses and span; topics on change or of several senders."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.core.channels import control_of
from offpiste.inspection.clocks import RECEIVE, other_origin
from offpiste.inspection.findings import Cure, Finding, found, merged
from offpiste.inspection.recorded_log import Recorded, beginning, rising
from offpiste.logs.channel import LEAST_KEPT
from offpiste.logs.log import Samples
from offpiste.rig.channels import OTHER_CHANNELS, SECONDS_PER_UNIT, ChannelSource, Clock
from offpiste.rig.edits import Edit
from offpiste.rig.labels import unit_by_rate
from offpiste.rig.rig import Rig

_SINGLE: Final = 0.25
"""Minimum share of single-period intervals; up to three in four samples may be lost at random."""
_LATE: Final = 2.0
"""Minimum time by which a reported topic starts after the pose or ends before it [s]."""
_ZONE: Final = 900.0
"""Resolution of time zone offsets [s]."""
_SOME: Final = 0.02
"""Share of repeated stamps that is negligible, and of lost samples that is not reported."""
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
_BEFORE: Final = 4
"""Number of previous samples among which the nearest belongs to the same sender."""
_TURNS: Final = 0.3
"""Minimum share of samples of alternating senders that continue a sample before the last."""
_NEARER: Final = 0.1
"""Maximum distance to the continued sample, as a share of the distance to the last one."""
_LARGE, _LARGE_STEP = 0.1, 0.002
"""Minimum distance to the last sample, as a share of the range of values; of the extent of the path for positions."""


@dataclass(frozen=True)
class Timing:
    """Statistics of a topic's stamps.

    Attributes:
        start, end: first and last stamp kept on reading [s]; NaN if there is none.
        count: number of finite stamps.
        repeated, backward: number of stamps equal to, or earlier than, the previous one.
        dropped: number of stamps dropped on reading as they repeat or go back.
        rate: samples per second excluding losses and gaps [Hz]; NaN for fewer than three samples.
        jitter: half the spread from the 5th to the 95th percentile of the intervals, divided by the sample interval.
        lost: share of samples missing at this rate, excluding gaps.
        gaps: (start, length) of intervals between kept stamps that are longer than the clock's `max_gap` and ten times
            the sample interval [s].
    """

    start: float
    end: float
    count: int
    repeated: int
    backward: int
    dropped: int
    rate: float = np.nan
    jitter: float = 0.0
    lost: float = 0.0
    gaps: tuple[tuple[float, float], ...] = ()


def timing(time: Float[np.ndarray, " n"], *, max_gap: float) -> Timing:
    """Return statistics of stamps [s], ignoring non-finite ones."""
    time = time[np.isfinite(time)]
    step, kept = np.diff(time), rising(time)
    forward = step[step > 0]
    start, end = (float(kept[0]), float(kept[-1])) if len(kept) else (np.nan, np.nan)
    repeated, backward = int((step == 0).sum()), int((step < 0).sum())
    seen = Timing(start, end, len(time), repeated, backward, len(time) - len(kept))
    if len(forward) < 2:
        return seen
    low, period, high = np.percentile(forward, (5, 50, 95))
    longest, lost = max(max_gap, 10 * period), None
    if repeated < _SOME * len(time):
        period, lost = _period(forward[forward <= longest], period)
    # For samples in bunches or at irregular times, only the mean gives the rate; otherwise losses would bias it.
    single = forward[np.round(forward / period) == 1]
    interval = float(np.mean(step[(step >= 0) & (step <= longest)] if lost is None else single))
    between = np.diff(kept)
    gaps = tuple((float(kept[i]), float(between[i])) for i in np.flatnonzero(between > max(max_gap, 10 * interval)))
    return replace(seen, rate=1 / interval, jitter=(high - low) / 2 / interval, lost=lost or 0.0, gaps=gaps)


def _period(intervals: Float[np.ndarray, " n"], typical: float) -> tuple[float, float | None]:
    """Return the period of samples [s] and the share that is lost; None if the intervals are not multiples of one.

    Args:
        typical: median of the intervals, which exceeds one period if many samples are lost [s].
    """
    for period in (typical, typical / 2, typical / 3):
        periods = intervals / period
        whole = np.round(periods)
        # The interval between duplicate messages is not a period: a loss of three in four samples is implausible.
        # Stamps with a coarse clock are integer multiples of its tick as well, but rarely one tick apart.
        steady = np.mean(np.abs(periods - whole)) <= 0.1 and np.mean(periods) <= 1 / _SINGLE
        if len(periods) >= 50 and steady and np.mean(whole == 1) > _SINGLE:
            return period, float(np.sum(whole - 1) / max(np.sum(whole), 1))
    return typical, None


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
        own = _order(where, topic, seen, origin, clock) + _repeats(where, topic, seen, readers)
        own += [] if name in silent else _intervals(where, seen, origin, clock, used=name in used)
        findings += own if name in used else [replace(finding, severity="note") for finding in own]
    return merged(findings)


def _complete(topic: Recorded, source: ChannelSource) -> Samples:
    """Return the rows that hold all fields of a channel."""
    values = topic.columns(source)
    known = np.isfinite(topic.time) & np.isfinite(values).all(axis=1)
    return Samples(topic.time[known], values[known])


def _by_arrival(topic: Recorded) -> Cure:
    """Return the edit that reads header stamps by arrival times, if these are in order."""
    arrived = topic.arrived
    return (RECEIVE,) if arrived is not None and len(arrived) > 1 and np.mean(np.diff(arrived) > 0) > 0.99 else ()


def _order(where: str, topic: Recorded, seen: Timing, origin: float, clock: Clock) -> list[Finding]:
    """Return findings on stamps that are not finite or go back."""
    total, receive = len(topic.time), _by_arrival(topic)
    values = {"total": total, "bad": total - seen.count, "backward": seen.backward, "dropped": seen.dropped}
    findings = []
    if seen.count < total:
        findings.append(found("stamps_not_finite", where, values, receive, score=1 - seen.count / total))
    if not seen.backward:
        return findings
    with np.errstate(invalid="ignore"):  # infinite stamps
        step = np.diff(topic.time)
    worst, share = int(np.nanargmin(step)), seen.backward / total
    values |= {"by": -step[worst], "at": topic.time[worst] - origin}
    late = bool(receive) and not _was_set_back(topic)
    score = seen.dropped / total
    if share > _SHUFFLED and not clock.sort:
        sort = (Edit("clock.sort", True),)
        code = "disorder" if share > _DISORDER else "stamps_go_back"
        return [*findings, found(code, where, values, *((sort, receive) if late else (receive, sort)), score=score)]
    if late:  # arrival times would add delays to all samples to fix a few late ones
        return [*findings, found("stamps_go_back", where, values, severity="note", score=score)]
    return [*findings, found("stamps_go_back", where, values, receive, score=score)]


def _was_set_back(topic: Recorded) -> bool:
    """Return whether the delay until arrival grows at a backward step of the stamps, unlike for single late samples."""
    delay, back = topic.arrival - topic.time, np.flatnonzero(np.diff(topic.time) < 0)
    return any(
        np.nanmedian(delay[at + 1 : at + 21]) - np.nanmedian(delay[max(at - 19, 0) : at + 1])
        > (topic.time[at] - topic.time[at + 1]) / 2
        for at in back[:100]
    )


def _repeats(where: str, topic: Recorded, seen: Timing, readers: Sequence[Samples]) -> list[Finding]:
    """Return a finding if stamps repeat in a channel, or in a topic that no channel reads.

    Args:
        readers: samples that each channel reads.
    """
    repeated = max((int((np.diff(samples.time) == 0).sum()) for samples in readers), default=seen.repeated)
    if not repeated:
        return []
    total, kept, receive = len(topic.time), len(topic.rising), _by_arrival(topic)
    score, values = repeated / total, {"repeated": repeated, "total": total, "each": total / max(kept, 1)}
    if topic.copies:
        return [found("stamps_repeat", where, values, severity="note", score=score, remedy="of_copies")]
    if not receive and not seen.backward and any(map(_refused, readers)):
        rate = f", of which there are {(kept - 1) / (seen.end - seen.start):.3g} a second" if kept > 1 else ""
        return [found("stamps_too_coarse", where, {"rate": rate, **values}, score=score)]
    return [found("stamps_repeat", where, values, receive, score=score)]


def _refused(samples: Samples) -> bool:
    """Return whether reading rejects a channel because too many different samples share a stamp."""
    copies = (np.diff(samples.time) == 0) & (np.diff(samples.values, axis=0) == 0).all(axis=1)
    return len(np.unique(samples.time)) < LEAST_KEPT * (len(samples.time) - copies.sum())


def _intervals(where: str, seen: Timing, origin: float, clock: Clock, *, used: bool) -> list[Finding]:
    """Return findings on the unit of stamps, gaps and lost samples; unordered stamps have no rate."""
    if not np.isfinite(seen.rate) or seen.backward > _DISORDER * seen.count:
        return []
    seconds, period = seen.end - seen.start, 1 / seen.rate
    unit = unit_by_rate(seen.rate, clock.unit, seen.start / SECONDS_PER_UNIT[clock.unit])
    if used and seen.count > 20 and unit != clock.unit:
        return [found("stamp_unit", where, {"rate": seen.rate, "seconds": seconds}, (Edit("clock.unit", unit),))]
    findings = []
    if period > clock.max_gap and used:
        edit = Edit("clock.max_gap", float(np.ceil(20 * period) / 10))
        findings.append(found("slow", where, {"period": period, "max_gap": clock.max_gap}, (edit,)))
    # Topics without a steady rate are published on events, so their silence is no gap.
    elif seen.gaps and (used or seen.jitter < 0.5):
        at, longest = max(seen.gaps, key=lambda gap: gap[1])
        share = sum(length for _, length in seen.gaps) / seconds
        what = "has gaps" if len(seen.gaps) > 1 else "has a gap"
        values = {"what": what, "count": len(seen.gaps), "longest": longest, "at": at - origin}
        findings.append(found("gaps", where, values, score=share))
    if seen.lost > _SOME:
        findings.append(found("losses", where, {"rate": seen.rate}, score=seen.lost))
    return findings


def check_spans(
    recorded: Mapping[str, Recorded],
    pose: str,
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
        if (origin := other_origin(recorded, name, pose, used=used or name in delays)) is not None:
            findings.append(origin)
        elif own[1] < span[0] or own[0] > span[1]:
            delayed = {key: source for key, source in channels.items() if source.topic == name}
            cure = (RECEIVE,) if topic.arrived is not None else _by_delays(delayed, own[0] - span[0])
            values = {"pose": pose, "own": "{:.2f} to {:.2f}".format(*own), "span": "{:.2f} to {:.2f}".format(*span)}
            findings.append(found("no_overlap", name, values, cure, severity="fatal" if used else "note"))
        else:
            others[name] = (own[0], max(own[1], span[1])) if name in silent else own
            findings += _part_of(name, others[name], span, pose, used=used)
    # If several topics agree on a longer drive, the pose stops early.
    if len(others) > 1:
        start, end = np.median(list(others.values()), axis=0).tolist()
        if start <= span[1] and end >= span[0]:
            findings += _part_of(pose, span, (start, end), "the other topics", used=used)
    return findings


def _span(topic: Recorded, delays: Mapping[str, float]) -> tuple[float, float]:
    time = topic.rising - delays.get(topic.topic.name, 0.0)
    return (float(time[0]), float(time[-1])) if len(time) else (np.nan, np.nan)


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
    values = {"late": late, "early": early, "whose": whose}
    return [found("part", name, values, severity=None if used else "note", score=share)]


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
        values = {"count": len(r.time), "new": new, "silences": silence.sum(), "max_gap": rig.clock.max_gap}
        cure = tuple(Edit(f"channels.{name}.interpolation", "on change") for name in changing)
        findings.append(found("on_change", topic or "table", values, cure, score=share))
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


def check_senders(recorded: Mapping[str, Recorded], rig: Rig) -> list[Finding]:
    """Report topics of the rig with several senders, recognised by alternating values."""
    shares: dict[str, float] = {}
    for name, source in rig.channels.items():
        topic = recorded.get(source.topic)
        if topic is not None and topic.has(source):
            shares[source.topic] = max(shares.get(source.topic, 0.0), _alternating(name, topic.columns(source)))
    return [found("senders", topic, {"share": share}) for topic, share in shares.items() if share > _TURNS]


def _alternating(name: str, values: Float[np.ndarray, "n k"]) -> float:
    """Return the share of samples of a channel that are closer to an earlier sample than to the last."""
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) < 20 * _BEFORE:
        return 0.0
    if name == "orientation":  # a quaternion and its negative are equal
        values = np.einsum("ni,nj->nij", values, values).reshape(len(values), -1)
    away = [np.linalg.norm(values[_BEFORE:] - values[_BEFORE - k : -k], axis=1) for k in range(1, _BEFORE + 1)]
    last, earlier = away[0], np.min(away[1:], axis=0)
    least = (_LARGE_STEP if name == "position" else _LARGE) * np.linalg.norm(
        np.subtract(*np.percentile(values, (95, 5), axis=0))
    )
    return float(np.mean((last > least) & (earlier < _NEARER * last)))
