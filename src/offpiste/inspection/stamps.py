"""Checks of stamps: rate, gaps, repeats, backward steps and inconsistent clocks."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.inspection.findings import Finding, Severity, merged
from offpiste.inspection.recorded_log import Recorded, beginning
from offpiste.inspection.several_clocks import ORIGINS, RECEIVE, arrivals, has_arrivals, other_origin
from offpiste.inspection.timing import Timing, timing
from offpiste.logs.channel import LEAST_KEPT
from offpiste.rig.channels import SECONDS_PER_UNIT, ChannelSource, Clock
from offpiste.rig.edits import Edit
from offpiste.rig.labels import unit_by_rate

MISSING: Final = "samples are missing"
_LATE = 2.0
"""Minimum time by which a reported topic starts after the pose or ends before it [s]."""
_ZONE: Final = 900.0
"""Resolution of time zone offsets [s]."""
_APART = 0.5
"""Minimum difference in delay between header and arrival that indicates another clock [s]."""
_SORT: Final = Edit("clock.sort", True)
_REPEATED: Final = 0.05
"""Share of repeated stamps above which the finding is a warning."""
_GAPS: Final = 0.02
"""Share of time in gaps above which the finding is a warning."""
_DISORDER: Final = 0.2
"""Share of backward steps above which the finding is fatal."""
_SHUFFLED: Final = 0.002
"""Share of backward steps above which sorting by stamp is offered."""


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
        where = name or "table"
        seen = timing(topic.time, max_gap=clock.max_gap)
        intervals = [] if name in silent else _intervals(where, seen, origin, clock, used=name in used)
        sources = [source for source in (channels or {}).values() if source.topic == name]
        seen = replace(seen, repeated=_repeated(topic, seen, sources))
        message = _order(where, topic, seen, origin, clock, refused=_refused(topic, sources)) + intervals
        findings += message if name in used else [replace(f, severity="note") for f in message]
    return merged(findings)


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
    delays = {source.topic: source.delay for source in (channels or {}).values()}
    span = _span(recorded[pose], delays.get(pose, 0.0))
    others = {
        name: _span(topic, delays.get(name, 0.0))
        for name, topic in recorded.items()
        if name != pose and np.isfinite(topic.time).sum() >= 3
    }
    findings = []
    for name, own in tuple(others.items()):
        if (origin := other_origin(recorded, name, pose, clock, used=used or name in delays)) is not None:
            findings.append(origin)
        elif own[1] < span[0] or own[0] > span[1]:
            other_clock = recorded[name].other is not None
            cure = (RECEIVE,) if other_clock else _other_clock(name, own[0] - span[0], channels or {})
            findings.append(
                Finding(
                    "fatal" if used else "note",
                    name,
                    f"its clock does not overlap that of {pose}",
                    f"{own[0]:.2f} to {own[1]:.2f} s against {span[0]:.2f} to {span[1]:.2f} s",
                    ", ".join(map(str, cure)) or "drop the topic, or fix its stamps",
                    1.0,
                    (cure,) if cure else (),
                )
            )
        else:
            own = others[name] = (own[0], max(own[1], span[1])) if name in silent else own
            findings += _part_of(name, own, span, pose, used=used)
    # If several topics agree on a longer drive, the pose stops early.
    if len(others) > 1:
        start, end = (float(np.median(edge)) for edge in zip(*others.values(), strict=True))
        if start <= span[1] and end >= span[0]:
            findings += _part_of(pose, span, (start, end), "the other topics", used=used)
    return findings


def _other_clock(topic: str, apart: float, channels: Mapping[str, ChannelSource]) -> tuple[Edit, ...]:
    """Return delays that align the start of a topic with the pose, or that correct a time zone offset."""
    zones = round(apart / _ZONE) * _ZONE
    apart = zones if abs(apart - zones) < _LATE else apart
    reading = {name: source for name, source in channels.items() if source.topic == topic}
    return tuple(Edit(f"channels.{name}.delay", round(source.delay + apart, 3)) for name, source in reading.items())


def _part_of(
    name: str, own: tuple[float, float], span: tuple[float, float], whose: str, *, used: bool
) -> list[Finding]:
    """Return a finding if a topic covers only a part of another time span."""
    late, early = max(own[0] - span[0], 0.0), max(span[1] - own[1], 0.0)
    if max(late, early) <= _LATE:
        return []
    share = (late + early) / (span[1] - span[0])
    evidence = f"{late:.1f} s after the start and {early:.1f} s before the end of {whose}: {share:.0%} of it"
    how = "nothing where the rest is enough: those rows are left out"
    severity: Severity = "warning" if used and share > 0.1 else "note"
    return [Finding(severity, name, "starts late or stops early", evidence, how, share)]


def _span(topic: Recorded, delay: float) -> tuple[float, float]:
    time = topic.rising - delay
    return (float(time[0]), float(time[-1])) if len(time) else (np.nan, np.nan)


def _repeated(topic: Recorded, seen: Timing, sources: Sequence[ChannelSource]) -> int:
    """Return the maximum number of repeated stamps in a channel, or in the topic if no channel reads it."""
    at = [[topic.fields.index(f) for f in source.fields] for source in sources if {*source.fields} <= {*topic.fields}]
    samples = [topic.time[np.isfinite(np.column_stack((topic.time, topic.values[:, c]))).all(axis=1)] for c in at]
    return max((int((np.diff(time) == 0).sum()) for time in samples), default=seen.repeated)


def _refused(topic: Recorded, sources: Sequence[ChannelSource]) -> bool:
    """Return whether reading rejects a channel because too many different samples share a stamp."""
    for source in sources:
        if not {*source.fields} <= {*topic.fields}:
            continue
        values = topic.values[:, [topic.fields.index(field) for field in source.fields]]
        known = np.isfinite(np.column_stack((topic.time, values))).all(axis=1)
        time, values = topic.time[known], values[known]
        copies = (np.diff(time) == 0) & (np.diff(values, axis=0) == 0).all(axis=1)
        if len(np.unique(time)) < LEAST_KEPT * (len(time) - copies.sum()):
            return True
    return False


def _order(
    where: str, topic: Recorded, seen: Timing, origin: float, clock: Clock, *, refused: bool = False
) -> list[Finding]:
    findings, total = [], len(topic.time)
    arrives = topic.other if topic.other is not None and clock.stamps == "header" else np.zeros(0)
    with np.errstate(invalid="ignore"):  # infinite stamps
        step, later = np.diff(topic.time), np.diff(arrives) > 0
    receives = later.size > 0 and bool(later.mean() > 0.99)
    remedy = str(RECEIVE) if receives else "nothing: those samples are dropped on reading"
    cures: tuple[tuple[Edit, ...], ...] = ((RECEIVE,),) if receives else ()
    if seen.count < total:
        share = 1 - seen.count / total
        evidence = f"{total - seen.count} of {total}"
        findings.append(Finding("warning", where, "stamps are not finite", evidence, remedy, share, cures))
    if seen.backward:
        worst = int(np.nanargmin(step))
        share = seen.backward / total
        evidence = f"{seen.backward} of {total}; by {-step[worst]:.3f} s at {topic.time[worst] - origin:.2f} s; "
        evidence += f"reading drops {seen.dropped} of {total} samples"
        late = receives and not _clock_was_set_back(topic.time, arrives)
        severity: Severity = "fatal" if share > _DISORDER else "warning"
        what, ways = "stamps go back", cures
        if share > _SHUFFLED and not clock.sort:
            ways = ((_SORT,), *cures) if late else (*cures, (_SORT,))
            what = "samples are not in the order of their stamps" if share > _DISORDER else what
        elif late:  # arrival times would add delays to all samples to fix a few late ones
            ways, severity = (), "note"
        how = str(ways[0][0]) if ways else "nothing: those samples are dropped on reading"
        findings.append(Finding(severity, where, what, evidence, how, seen.dropped / total, ways))
    if seen.repeated:
        share = seen.repeated / total
        evidence = f"{seen.repeated} of {total} ({share:.1%})"
        if topic.copies:
            how = "nothing: they are copies of the sample before, and one of each is kept"
            return [*findings, Finding("note", where, "stamps repeat", evidence, how, share)]
        if refused and not receives and not seen.backward:
            kept = len(topic.rising)
            evidence += f": {total / kept:.2g} samples for each"
            if kept > 1:
                evidence += f", of which there are {(kept - 1) / (seen.end - seen.start):.3g} a second"
            how = "take another clock.column; or export the stamps with all their decimals, or one row for each"
            return [*findings, Finding("fatal", where, "stamps repeat", evidence, how, share)]
        bunches = remedy if share <= 0.02 or receives else "nothing: one sample a stamp is kept"
        severity = "warning" if share > _REPEATED else "note"
        findings.append(Finding(severity, where, "stamps repeat", evidence, bunches, share, cures))
    return findings


def _clock_was_set_back(time: Float[np.ndarray, " n"], arrives: Float[np.ndarray, " n"]) -> bool:
    """Return whether the lag behind arrivals increases after a backward step, rather than for single late samples."""
    late, back = arrives - time, np.flatnonzero(np.diff(time) < 0)
    return any(
        np.nanmedian(late[at + 1 : at + 21]) - np.nanmedian(late[max(at - 19, 0) : at + 1])
        > (time[at] - time[at + 1]) / 2
        for at in back[:100]
    )


def _intervals(where: str, seen: Timing, origin: float, clock: Clock, *, used: bool) -> list[Finding]:
    findings: list[Finding] = []
    if not np.isfinite(seen.rate) or seen.backward > _DISORDER * seen.count:
        return findings  # unordered stamps have no rate
    unit = unit_by_rate(seen.rate, clock.unit, seen.start / SECONDS_PER_UNIT[clock.unit])
    if used and seen.count > 20 and unit != clock.unit:
        message = f"{seen.rate:.3g} samples a second, {seen.end - seen.start:.3g} s long"
        edit = Edit("clock.unit", unit)
        return [Finding("fatal", where, "stamps are in another unit", message, str(edit), 1.0, ((edit,),))]
    if 1 / seen.rate > clock.max_gap and used:
        edit = Edit("clock.max_gap", float(np.ceil(20 / seen.rate) / 10))
        evidence = f"one sample in {1 / seen.rate:.2f} s, clock.max_gap is {clock.max_gap} s"
        what, how = "is slower than the longest gap that is interpolated", f"{edit}; or use another topic"
        findings.append(Finding("warning", where, what, evidence, how, 1.0, ((edit,),)))
    # Topics without a steady rate are published on events, so their silence is no gap.
    elif seen.gaps and (used or seen.jitter < 0.5):
        at, longest = max(seen.gaps, key=lambda gap: gap[1])
        share = sum(length for _, length in seen.gaps) / (seen.end - seen.start)
        what, how = "has gaps" if len(seen.gaps) > 1 else "has a gap", "the drive is cut there (clock.max_gap)"
        evidence = f"{len(seen.gaps)}, the longest {longest:.2f} s at {at - origin:.2f} s; {share:.1%} of the time"
        severity: Severity = "warning" if share > _GAPS else "note"
        findings.append(Finding(severity, where, what, evidence, f"nothing where the rest is enough: {how}", share))
    if seen.lost > 0.02:
        severity, evidence = (
            "warning" if seen.lost > 0.1 else "note",
            f"{seen.lost:.1%} at a rate of {seen.rate:.1f} Hz",
        )
        how = "record with a larger queue; short holes are interpolated"
        findings.append(Finding(severity, where, MISSING, evidence, how, seen.lost))
    return findings


def check_headers(recorded: Mapping[str, Recorded], clock: Clock, *, used: Collection[str]) -> list[Finding]:
    """Compare header stamps with arrival times: headers never set, or a topic's clock offset from the others.

    Args:
        used: topics that a rig reads, if any; findings on others are notes.
    """
    both = {name: r for name, r in recorded.items() if len(r.time) > 2}
    if not has_arrivals(recorded, clock):
        return []
    late = {name: float(np.nanmedian(arrivals(r) - r.time)) for name, r in both.items()}
    usual = float(np.median(list(late.values())))
    findings = []
    for name, r in both.items():
        if r.other is not None and np.ptp(r.time) == 0:
            what, message, score = "all header stamps are equal", f"{r.time[0]:.3f} s in {len(r.time)} messages", 1.0
        elif _APART < abs(late[name] - usual) < ORIGINS and len(both) > 1:
            what, score = "its header's clock is apart from the others'", 0.6
            message = f"arrival is {late[name]:.2f} s after the header, {usual:.2f} s for the topic in the middle"
        else:
            continue
        if used and name not in used:
            findings.append(Finding("note", name, what, message, "none: no channel reads it", score))
        else:
            findings.append(Finding("warning", name, what, message, str(RECEIVE), score, ((RECEIVE,),)))
    return findings
