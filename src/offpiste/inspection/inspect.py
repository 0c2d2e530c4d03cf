"""Inspects a log: runs every check, and says what causes what was found."""

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
from offpiste.inspection.findings import Finding, is_fatal, ranked
from offpiste.inspection.recorded_log import Recorded, RememberedLog, with_fields_of
from offpiste.inspection.remedies import explain
from offpiste.inspection.sensors import can_be_checked, check_sensors
from offpiste.inspection.timing import timing
from offpiste.logs.log import Log
from offpiste.rig.channels import Clock
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig, parse_rig

UNDRAFTED = "by names and types of topics"
"""Evidence of the finding that no first rig can be written."""


@dataclass(frozen=True)
class TopicRow:
    """A topic's row in the table: rate [Hz] and length [s] are None where they are not known."""

    name: str
    type: str
    count: int
    rate: float | None
    seconds: float | None


@dataclass(frozen=True)
class Summary:
    """What was driven, by the pose; fields are None where no pose was found.

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
    """All that is known of a log before training on it.

    Attributes:
        rig: name of the rig that it was read through; "" if channels were guessed.
        findings: the worst first.
    """

    log: str
    rig: str
    summary: Summary
    topics: tuple[TopicRow, ...]
    findings: tuple[Finding, ...]
    warnings: tuple[str, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether the log can be trained on: no finding is fatal."""
        return not is_fatal(self.findings)

    @property
    def cure(self) -> tuple[Edit, ...]:
        """The edits of the rig that cure what can be cured, in their order; notes cure nothing."""
        return tuple(edit for f in self.findings if f.severity != "note" for cure in f.cures[:1] for edit in cure)

    def with_findings(self, more: Iterable[Finding]) -> "Inspection":
        """The same inspection with further findings: causes keep the order in which to cure them, notes come last."""
        together = (*self.findings, *ranked(more))
        return replace(self, findings=tuple(sorted(together, key=lambda finding: finding.severity == "note")))

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, texts and lists, for JSON."""
        return {"schema": 2, "usable": self.usable, **asdict(self)}


def summarise(recorded: dict[str, Recorded], path: DrivenPath | None) -> Summary:
    """Length of the log, and of the driven path its length and speeds."""
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
    """A row for every topic of a log, and for those parts of one that the rig reads."""
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


def inspect_log(log: Log, rig: Rig | None = None, *, sensors: bool = False) -> Inspection:
    """Find out what is wrong with a log, or with a log read through a rig.

    Args:
        rig: channels are checked as it converts them, so that the right rig silences a finding. Without one all
            topics are checked as recorded, and motion through a rig drafted from names (`draft_rig`).
        sensors: also check the cameras and LiDARs that the rig names; takes up to some minutes.
    """
    rig = None if rig is None else with_fields_of(log, rig)
    remembered = RememberedLog(log, rig)
    used_rig, unusable = (rig, []) if rig is not None else _drafted(remembered)
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


def _drafted(log: Log) -> tuple[Rig | None, list[Finding]]:
    try:
        return parse_rig(draft_rig(log), where="the drafted rig"), []
    except OffpisteError as error:
        return None, [Finding("fatal", "log", error.what, UNDRAFTED, error.how, 1.0)]
