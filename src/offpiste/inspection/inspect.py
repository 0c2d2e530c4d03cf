"""Inspects a log: runs every check, ranks the findings, and shows them."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from offpiste.errors import OffpisteError
from offpiste.inspection.checks import MOTION_CHECKS, TOPIC_CHECKS, Topics, motion_of
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.driven_path import MOVING, Path, driven_path
from offpiste.inspection.findings import Finding, is_fatal, ranked
from offpiste.inspection.pose import check_orientation, check_pose, check_position_unit
from offpiste.inspection.recorded_log import Recorded, RememberedLog, read_topics
from offpiste.inspection.sensors import check_sensors
from offpiste.inspection.stamps import check_spans, timing
from offpiste.logs.drive import drive_from_log
from offpiste.logs.log import Log
from offpiste.rig.channels import Clock
from offpiste.rig.rig import Rig, parse_rig


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

    def with_findings(self, more: Iterable[Finding]) -> "Inspection":
        """The same inspection with further findings, ranked anew."""
        return replace(self, findings=ranked((*self.findings, *more)))

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, texts and lists, for JSON."""
        return {"schema": 2, "usable": self.usable, **asdict(self)}


def summarise(recorded: dict[str, Recorded], path: Path | None) -> Summary:
    """Length of the log, and of the driven path its length and speeds."""
    stamps = [r.time[np.isfinite(r.time)] for r in recorded.values()]
    stamps = [s for s in stamps if len(s)]
    duration = float(max(s.max() for s in stamps) - min(s.min() for s in stamps)) if stamps else 0.0
    if path is None or not np.isfinite(path.speed).any():
        return Summary(duration)
    speed = path.speed[np.isfinite(path.speed)]
    middle, fast, top = np.percentile(speed, (50, 95, 100))
    return Summary(duration, path.distance, float(middle), float(fast), float(top), float(np.mean(speed < MOVING)))


def topic_rows(log: Log, recorded: dict[str, Recorded], clock: Clock) -> tuple[TopicRow, ...]:
    """A row for every topic of a log."""
    rows = []
    for name, topic in log.topics.items():
        seen = timing(recorded[name].time, max_gap=clock.max_gap) if name in recorded else None
        rate = seen.rate if seen and np.isfinite(seen.rate) else None
        seconds = seen.end - seen.start if seen and np.isfinite(seen.start) else None
        rows.append(TopicRow(name or "table", topic.type, topic.count, rate, seconds))
    return tuple(rows)


_STYLE = {"fatal": "bold red", "warning": "yellow", "note": "dim"}


def render(inspection: Inspection) -> RenderableType:
    """A header, the table of topics, the findings with evidence and remedy, a verdict; for `rich.print`."""
    parts: list[RenderableType] = [Text(_headline(inspection), style="bold"), _topics(inspection)]
    parts += [Text(f"reader: {message}", style="dim") for message in inspection.warnings]
    if inspection.findings:
        parts += [_finding(i, finding) for i, finding in enumerate(inspection.findings, start=1)]
    else:
        parts.append(Text("nothing to fix"))
    parts.append(_verdict(inspection))
    return Group(*parts)


def render_text(inspection: Inspection, *, width: int = 120) -> str:
    """An inspection as plain text."""
    console = Console(width=width, no_color=True, highlight=False)
    with console.capture() as capture:
        console.print(render(inspection))
    return capture.get()


def _headline(inspection: Inspection) -> str:
    summary = inspection.summary
    read = f"through rig '{inspection.rig}'" if inspection.rig else "without a rig: channels are guessed"
    text = f"{inspection.log}, {read}\n{summary.duration:.1f} s"
    if summary.distance is not None:
        text += (
            f", {summary.distance:.0f} m; speed {summary.speed_median:.1f} m/s median, {summary.speed_p95:.1f} m/s at "
            f"95 %, {summary.speed_max:.1f} m/s at most; at a standstill {summary.standing:.0%} of the time"
        )
    return text


def _topics(inspection: Inspection) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("topic", "type"):
        table.add_column(name, overflow="fold")
    for name in ("samples", "Hz", "s"):
        table.add_column(name, justify="right")
    for row in inspection.topics:
        rate = "" if row.rate is None else f"{row.rate:.1f}"
        seconds = "" if row.seconds is None else f"{row.seconds:.1f}"
        table.add_row(row.name, row.type, str(row.count), rate, seconds)
    return table


def _finding(index: int, finding: Finding) -> Text:
    text = Text(f"\n{index}. ")
    text.append(finding.severity, style=_STYLE[finding.severity])
    text.append(f"  {finding.where}: {finding.what}\n", style="bold" if finding.severity != "note" else "")
    text.append(f"   seen: {finding.evidence}\n")
    text.append("   fix: ")
    text.append(finding.remedy, style="cyan")
    return text


def _verdict(inspection: Inspection) -> Text:
    count = {s: sum(f.severity == s for f in inspection.findings) for s in _STYLE}
    message = ", ".join(f"{n} {name}{'s' if n > 1 and name != 'fatal' else ''}" for name, n in count.items() if n)
    verdict = "usable for training" if inspection.usable else "NOT usable for training"
    return Text(
        f"\n{verdict}" + (f" ({message})" if message else ""), style="bold green" if inspection.usable else "bold red"
    )


_LEAST_DRIVING = 6.0
"""A window and its history take 5.2 s; less driving than this holds none to learn from [s]."""
_LEAST_CRUISE = 0.2
"""A log that never moves faster was not driven [m/s]."""


def inspect_log(log: Log, rig: Rig | None = None, *, sensors: bool = False) -> Inspection:
    """Find out what is wrong with a log, or with a log read through a rig.

    Args:
        rig: channels are checked as it converts them, so that the right rig silences a finding. Without one all
            topics are checked as recorded, and motion through a rig drafted from names (`draft_rig`).
        sensors: also check the cameras and LiDARs that the rig names; takes up to some minutes.
    """
    remembered = RememberedLog(log, rig)
    clock = rig.clock if rig else Clock()
    recorded, findings = read_topics(remembered, stamps=clock.stamps)
    used_rig, unusable = (rig, []) if rig is not None else _drafted(remembered)
    topics = Topics(recorded, used_rig, given=rig is not None)
    if topics.given:
        findings = [f for f in findings if f.where in {name or "table" for name in topics.used}]
    findings += unusable
    for check in TOPIC_CHECKS:
        findings += check(topics)
    path = None
    if used_rig is not None and not is_fatal(findings):
        more, path = _check_driving(remembered, topics, used_rig)
        findings += more
    name, summary = rig.name if rig else "", summarise(recorded, path)
    rows = topic_rows(remembered, recorded, clock)
    inspection = Inspection(str(log.path), name, summary, rows, ranked(findings), tuple(remembered.warnings))
    if sensors and rig is not None and inspection.usable:
        return inspection.with_findings(check_sensors(log, rig))
    return inspection


def _drafted(log: Log) -> tuple[Rig | None, list[Finding]]:
    try:
        return parse_rig(draft_rig(log), where="the drafted rig"), []
    except OffpisteError as error:
        return None, [Finding("fatal", "log", error.what, "by names and types of topics", error.how, 1.0)]


def _check_driving(log: Log, topics: Topics, rig: Rig) -> tuple[list[Finding], Path | None]:
    """Findings on the pose, and on channels against the driven path; and the path, where there is one."""
    pose = rig.channels["position"].topic
    findings = check_spans(topics.inspected, pose, used=topics.given) if pose in topics.inspected else []
    tilted = _check_orientation(topics.recorded, rig)
    findings += tilted
    try:
        drive = drive_from_log(log, rig)
        path = driven_path(drive)
    except OffpisteError as error:
        return [*findings, Finding("fatal", "log", error.what, "on reading it", error.how, 1.0)], None
    unfit = check_position_unit(drive, path) or _check_amount(path)
    if unfit:
        return findings + unfit, path
    origin = min(float(np.nanmin(r.time)) for r in topics.recorded.values() if np.isfinite(r.time).any())
    posed = check_pose(drive, path, origin)
    findings += posed
    if not is_fatal(tilted + posed):
        motion = motion_of(topics, drive, path)
        for check in MOTION_CHECKS:
            findings += check(motion)
    return findings, path


def _check_orientation(recorded: dict[str, Recorded], rig: Rig) -> list[Finding]:
    source = rig.channels.get("orientation")
    if source is None or source.topic not in recorded or not set(source.fields) <= set(recorded[source.topic].fields):
        return []
    r = recorded[source.topic]
    return check_orientation(r.values[:, [r.fields.index(field) for field in source.fields]], rig)


def _check_amount(path: Path) -> list[Finding]:
    """A finding if there is too little driving to learn from."""
    if path.driving >= _LEAST_DRIVING and path.cruise >= _LEAST_CRUISE:
        return []
    evidence = f"{path.driving:.1f} s faster than {MOVING} m/s, {path.distance:.1f} m, 95 % of the speeds below "
    evidence += f"{path.cruise:.2f} m/s"
    what = "hardly moves" if path.driving < 1 else "is driven for too short a time"
    return [Finding("fatal", "position", what, evidence, "record more driving, or fix channels.position", 1.0)]
