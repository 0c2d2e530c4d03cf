"""Inspection of a log: all checks, and the causes of their findings."""

from collections.abc import Iterable
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from itertools import count
from typing import Any

import numpy as np

from offpiste.core.errors import OffpisteError
from offpiste.core.progress import track
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.driven_path import DrivenPath
from offpiste.inspection.examination import examine
from offpiste.inspection.findings import Finding, is_fatal, ranked, unreadable
from offpiste.inspection.recorded_log import Recorded, RememberedLog, with_fields_of
from offpiste.inspection.remedies import explain
from offpiste.inspection.sensors import can_be_checked, check_sensors
from offpiste.inspection.stamps import timing
from offpiste.logs.log import Log
from offpiste.rig.channels import Clock
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig, parse_rig


@dataclass(frozen=True)
class TopicRow:
    """A topic's row in the table: rate [Hz] and length [s], or None if unknown."""

    name: str
    type: str
    count: int
    rate: float | None
    seconds: float | None


@dataclass(frozen=True)
class Summary:
    """Summary of a drive, computed from the pose; fields are None without a pose.

    Attributes:
        duration: length of the log [s].
        distance: length of the driven path [m].
        speed_median, speed_p95, speed_max: [m/s].
        standing: share of the time at a standstill.
    """

    duration: float
    distance: float | None = None
    speed_median: float | None = None
    speed_p95: float | None = None
    speed_max: float | None = None
    standing: float | None = None


@dataclass(frozen=True)
class Inspection:
    """Results of inspecting a log before training.

    Attributes:
        rig: name of the rig used; "" if channels were guessed.
        findings: worst first.
    """

    log: str
    rig: str
    summary: Summary
    topics: tuple[TopicRow, ...]
    findings: tuple[Finding, ...]
    warnings: tuple[str, ...] = ()

    @property
    def usable(self) -> bool:
        """Return True if the log can be used for training, i.e. without fatal findings."""
        return not is_fatal(self.findings)

    @property
    def cure(self) -> tuple[Edit, ...]:
        """Return the rig edits that fix the findings, in order; notes have no fix."""
        return tuple(edit for f in self.findings if f.severity != "note" for cure in f.cures[:1] for edit in cure)

    def with_findings(self, more: Iterable[Finding]) -> "Inspection":
        """Add findings; causes keep the order of their fixes, notes come last."""
        together = (*self.findings, *ranked(more))
        return replace(self, findings=tuple(sorted(together, key=lambda finding: finding.severity == "note")))

    def as_dict(self) -> dict[str, Any]:
        """Return plain numbers, strings and lists for JSON."""
        return {"schema": 2, "usable": self.usable, **asdict(self)}


def summarise(recorded: dict[str, Recorded], path: DrivenPath | None) -> Summary:
    """Return the length of the log, and the length and speeds of the driven path."""
    stamps = [r.rising for r in recorded.values() if len(r.rising)]
    duration = float(max(s[-1] for s in stamps) - min(s[0] for s in stamps)) if stamps else 0.0
    if path is None or not np.isfinite(path.speed).any():
        return Summary(duration)
    speed = path.speed[np.isfinite(path.speed)]
    middle, fast, top = np.percentile(speed, (50, 95, 100))
    return Summary(
        duration, path.distance, float(middle), float(fast), float(top), float(np.mean(speed < path.slowest))
    )


def topic_rows(log: Log, recorded: dict[str, Recorded], clock: Clock) -> tuple[TopicRow, ...]:
    """Return a row for every topic of a log, and for each part of a topic that the rig reads."""
    rows = []
    for name, topic in log.topics.items():
        seen = timing(recorded[name].time, max_gap=clock.max_gap) if name in recorded else None
        rate = seen.rate if seen and np.isfinite(seen.rate) else None
        seconds = seen.end - seen.start if seen and np.isfinite(seen.start) else None
        if not topic.part_of:
            rows.append(TopicRow(name or "table", topic.type, topic.count, rate, seconds))
        elif name in recorded:
            rows.append(TopicRow(name, topic.type, len(recorded[name].time), rate, seconds))
    return tuple(rows)


def inspect_log(log: Log, rig: Rig | None = None, *, sensors: bool = False, namespace: str = "") -> Inspection:
    """Inspect a log, optionally as read through a rig.

    Args:
        rig: channels are checked after conversion, so that a correct rig removes findings. Without one, topics are
            checked as recorded, and the motion with a rig drafted from names (`draft_rig`).
        sensors: also check the rig's cameras and LiDARs; takes up to some minutes.
        namespace: of the vehicle, if the log holds several; for a draft.
    """
    rig = None if rig is None else with_fields_of(log, rig)
    remembered = RememberedLog(log, rig)
    used_rig, unusable = (rig, []) if rig is not None else _drafted(remembered, namespace)
    given = rig is not None
    examined = examine(remembered, used_rig, given=given)
    findings = examined.findings
    if used_rig is not None:
        with closing(track(count(), "trying remedies")) as trials:

            def tried(other: Rig) -> tuple[Finding, ...]:
                next(trials)
                return examine(remembered, other, given=given, again=True).findings

            findings = explain(findings, used_rig, tried)
    clock = rig.clock if rig else Clock()
    name, summary = rig.name if rig else "", summarise(examined.recorded, examined.path)
    rows = topic_rows(remembered, examined.recorded, clock)
    findings = (*ranked(unusable), *findings)
    inspection = Inspection(str(log.path), name, summary, rows, findings, tuple(remembered.warnings))
    if used_rig is not None and not given and inspection.cure:  # a draft is read as it will be written
        as_cured = examine(remembered, edited(used_rig, inspection.cure), given=False, again=True)
        inspection = replace(inspection, summary=summarise(as_cured.recorded, as_cured.path))
    if sensors and rig is not None and can_be_checked(findings, rig):
        return inspection.with_findings(check_sensors(log, rig, inspection.cure))
    return inspection


def _drafted(log: Log, namespace: str) -> tuple[Rig | None, list[Finding]]:
    try:
        return parse_rig(draft_rig(log, namespace), where="the drafted rig"), []
    except OffpisteError as error:
        return None, [unreadable("log", error, "by names and types of topics", code="undrafted")]
