"""The inspection of a log: all checks, ranked.

An inspection for people.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from offpiste.channels import all_controls
from offpiste.errors import OffpisteError
from offpiste.inspection.clocks import check_clocks
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.driven_path import MOVING, Path, driven_path
from offpiste.inspection.findings import Finding, ranked
from offpiste.inspection.pose import check_orientation, check_pose, check_position_unit, heading_fits
from offpiste.inspection.ranges import check_ranges
from offpiste.inspection.recorded_log import Recorded, RememberedLog, read_topics
from offpiste.inspection.response import check_copies, check_other_controls, check_pedals, check_steering
from offpiste.inspection.signals import channel_signals, check_signals, recorded_signals
from offpiste.inspection.stamps import check_spans, check_stamps, timing
from offpiste.inspection.velocity import check_linear_velocity, check_turn_rate
from offpiste.logs.drive import Drive, drive_from_log
from offpiste.logs.log import Log
from offpiste.rig.rig import Clock, Rig, parse_rig

_LEAST_DRIVING = 6.0
"""A window and its history take 5.2 s; less driving than this holds none to learn from [s]."""
_LEAST_CRUISE = 0.2
"""A log that never moves faster was not driven [m/s]."""


@dataclass(frozen=True)
class TopicRow:
    """One line of the table of topics; `rate` [Hz] is None where it is not known."""

    name: str
    type: str
    count: int
    rate: float | None
    seconds: float | None


@dataclass(frozen=True)
class Summary:
    """What was driven, by the pose; None where no pose was found.

    Attributes:
        duration: of the log [s].
        distance: [m].
        speed_median, speed_p95, speed_max: [m/s].
        standing: share of the time.
    """

    duration: float
    distance: float | None = None
    speed_median: float | None = None
    speed_p95: float | None = None
    speed_max: float | None = None
    standing: float | None = None


@dataclass(frozen=True)
class Inspection:
    """What there is to know about a log before training on it.

    Attributes:
        rig: name of the rig that it was judged by; "" for guesses.
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
        return not any(finding.severity == "fatal" for finding in self.findings)

    def with_findings(self, more: Iterable[Finding]) -> "Inspection":
        """The same with what a later stage found, too."""
        return replace(self, findings=ranked((*self.findings, *more)))

    def as_dict(self) -> dict[str, Any]:
        """For machines: plain numbers, texts, lists."""
        return {"schema": 1, "usable": self.usable, **asdict(self)}


def inspect_log(log: Log, rig: Rig | None = None) -> Inspection:
    """Everything that can be found out about a log, or about a log read through a rig.

    Args:
        rig: judges the channels as it converts them, so that the right rig silences a finding. Without one all
            topics are judged as recorded, and motion through a rig drafted from names (`draft_rig`).
    """
    log = RememberedLog(log, rig)
    clock = rig.clock if rig else Clock()
    recorded, findings = read_topics(log, stamps=clock.stamps)
    if rig is None:
        judged, said = _drafted(log)
        findings += said + check_signals(recorded_signals(recorded, judged))
        used = _read_by(judged) if judged else set()
        findings += check_stamps(recorded, clock, used=used)
    else:
        judged, used = rig, _read_by(rig)
        findings = [f for f in findings if f.where in {name or "table" for name in used}]
        findings += check_signals(channel_signals(recorded, rig)) + check_ranges(recorded, rig)
        findings += check_stamps({name: r for name, r in recorded.items() if name in used}, clock, used=used)

    path = None
    if judged is not None and not any(f.severity == "fatal" for f in findings):
        said, path = _check_driving(log, recorded, judged, given=rig is not None)
        findings += said
    return Inspection(
        str(log.path),
        rig.name if rig else "",
        _summary(recorded, path),
        _rows(log, recorded, clock),
        ranked(findings),
        tuple(log.warnings),
    )


def _read_by(rig: Rig) -> set[str]:
    """Topics that a rig reads."""
    return {source.topic for source in rig.channels.values()} | (
        {rig.alignment.speed.topic} if rig.alignment else set()
    )


def _drafted(log: Log) -> tuple[Rig | None, list[Finding]]:
    try:
        return parse_rig(draft_rig(log), where="the drafted rig"), []
    except OffpisteError as error:
        return None, [Finding("fatal", "log", error.what, "by names and types of topics", error.how, 1.0)]


def _check_driving(
    log: Log, recorded: dict[str, Recorded], rig: Rig, *, given: bool
) -> tuple[list[Finding], Path | None]:
    """Pose, velocities, response and clocks."""
    pose = rig.channels["position"].topic
    spanned = {name: r for name, r in recorded.items() if not given or name in _read_by(rig)}
    findings = check_spans(spanned, pose, used=given) if pose in spanned else []
    tilted: list[Finding] = []
    source = rig.channels.get("orientation")
    if source and source.topic in recorded and set(source.fields) <= set(recorded[source.topic].fields):
        r = recorded[source.topic]
        tilted = check_orientation(r.values[:, [r.fields.index(f) for f in source.fields]], rig)
        findings += tilted
    try:
        drive = drive_from_log(log, rig)
        path = driven_path(drive)
    except OffpisteError as error:
        return [*findings, Finding("fatal", "log", error.what, "on reading it", error.how, 1.0)], None
    unfit = check_position_unit(drive, path) or _check_motion(path)
    if unfit:
        return findings + unfit, path
    origin = min(float(np.nanmin(r.time)) for r in recorded.values() if np.isfinite(r.time).any())
    posed = check_pose(drive, path, origin)
    findings += posed
    if not any(f.severity == "fatal" for f in tilted + posed):
        findings += _check_channels(drive, path, recorded, given=given)
    return findings, path


def _check_motion(path: Path) -> list[Finding]:
    if path.driving >= _LEAST_DRIVING and path.cruise >= _LEAST_CRUISE:
        return []
    said = f"{path.driving:.1f} s faster than {MOVING} m/s, {path.distance:.1f} m, 95 % of the speeds below "
    said += f"{path.cruise:.2f} m/s"
    what = "hardly moves" if path.driving < 1 else "is driven for too short a time"
    return [Finding("fatal", "position", what, said, "record more driving, or mend channels.position", 1.0)]


def _check_channels(drive: Drive, path: Path, recorded: dict[str, Recorded], *, given: bool) -> list[Finding]:
    findings: list[Finding] = []
    if heading_fits(path):
        if "linear_velocity" in drive.channels:
            findings += check_linear_velocity(drive, path)
        findings += check_turn_rate(drive, path)
    clocks = check_clocks(recorded, path, drive.rig, besides={drive.rig.channels["position"].topic})
    copies = [] if given else check_copies(drive, recorded)
    steering, steers = check_steering(drive, path, measured=given) if heading_fits(path) else ([], True)
    pedals, drives = check_pedals(drive, path)
    findings += clocks + steering + pedals + copies
    if "steer" not in drive.channels and drives:
        what, said = "there is no steering", "pedals alone do not tell where the vehicle goes"
        mend = "add [channels.steer] with the topic that holds it: commanded, or else measured"
        said += "" if given else "; no field is named so: a rig can name it, and without it nothing can be trained"
        # Without a rig only names were guessed, and the topic may have another.
        findings.append(Finding("fatal" if given else "warning", "controls", what, said, mend, 1.0))
    if not steers and not drives and not check_other_controls(drive, path):
        present = [control.name for control in all_controls() if control.name in drive.channels]
        what = "no control has any effect" if present else "there is no control channel"
        said = f"judged: {', '.join(present) or 'none'}; {path.distance:.0f} m driven"
        mend = "add [channels.steer] and [channels.throttle] with the topics that hold them"
        findings.append(Finding("fatal", "controls", what, said, mend, 1.0))
    return findings


def _summary(recorded: dict[str, Recorded], path: Path | None) -> Summary:
    stamps = [r.time[np.isfinite(r.time)] for r in recorded.values()]
    stamps = [s for s in stamps if len(s)]
    duration = float(max(s.max() for s in stamps) - min(s.min() for s in stamps)) if stamps else 0.0
    if path is None or not np.isfinite(path.speed).any():
        return Summary(duration)
    speed = path.speed[np.isfinite(path.speed)]
    middle, fast, top = np.percentile(speed, (50, 95, 100))
    return Summary(duration, path.distance, float(middle), float(fast), float(top), float(np.mean(speed < MOVING)))


def _rows(log: Log, recorded: dict[str, Recorded], clock: Clock) -> tuple[TopicRow, ...]:
    rows = []
    for name, topic in log.topics.items():
        seen = timing(recorded[name].time, max_gap=clock.max_gap) if name in recorded else None
        rate = seen.rate if seen and np.isfinite(seen.rate) else None
        seconds = seen.end - seen.start if seen and np.isfinite(seen.start) else None
        rows.append(TopicRow(name or "table", topic.type, topic.count, rate, seconds))
    return tuple(rows)


_STYLE = {"fatal": "bold red", "warning": "yellow", "note": "dim"}


def render(inspection: Inspection) -> RenderableType:
    """A header, the table of topics, the findings with evidence and mend, a verdict; for `rich.print`."""
    parts: list[RenderableType] = [Text(_headline(inspection), style="bold"), _topics(inspection)]
    parts += [Text(f"reader: {said}", style="dim") for said in inspection.warnings]
    if inspection.findings:
        parts += [_finding(i, finding) for i, finding in enumerate(inspection.findings, start=1)]
    else:
        parts.append(Text("nothing to mend"))
    parts.append(_verdict(inspection))
    return Group(*parts)


def render_text(inspection: Inspection, *, width: int = 120) -> str:
    """The same as plain text."""
    console = Console(width=width, no_color=True, highlight=False)
    with console.capture() as capture:
        console.print(render(inspection))
    return capture.get()


def _headline(inspection: Inspection) -> str:
    summary = inspection.summary
    judged = f"through rig '{inspection.rig}'" if inspection.rig else "without a rig: channels are guessed"
    text = f"{inspection.log}, {judged}\n{summary.duration:.1f} s"
    if summary.distance is not None:
        text += (
            f", {summary.distance:.0f} m; speed {summary.speed_median:.1f} m/s median, {summary.speed_p95:.1f} m/s at "
            f"95 %, {summary.speed_max:.1f} m/s at the most; standing {summary.standing:.0%} of the time"
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
    text.append("   mend: ")
    text.append(finding.mend, style="cyan")
    return text


def _verdict(inspection: Inspection) -> Text:
    count = {s: sum(f.severity == s for f in inspection.findings) for s in _STYLE}
    said = ", ".join(f"{n} {name}{'s' if n > 1 and name != 'fatal' else ''}" for name, n in count.items() if n)
    verdict = "usable for training" if inspection.usable else "NOT usable for training"
    return Text(
        f"\n{verdict}" + (f" ({said})" if said else ""), style="bold green" if inspection.usable else "bold red"
    )
