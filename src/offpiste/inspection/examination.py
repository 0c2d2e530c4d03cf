"""Run of all channel checks on a log with one rig."""

from dataclasses import dataclass

from offpiste.core.errors import OffpisteError
from offpiste.inspection.checks import Topics, check_motion, check_topics
from offpiste.inspection.course import check_course
from offpiste.inspection.driven_path import MOVING, DrivenPath, driven_path
from offpiste.inspection.findings import Finding, fixable, is_fatal, ranked
from offpiste.inspection.heading_drift import check_fast_drift
from offpiste.inspection.pedals import check_control_channels
from offpiste.inspection.pose import check_orientation, check_pose, check_position_unit, leap_of
from offpiste.inspection.pose_samples import check_level
from offpiste.inspection.recorded_log import Recorded, RememberedLog, beginning, read_topics
from offpiste.inspection.stamps import check_spans
from offpiste.logs.channel import WORLD_DOWN
from offpiste.logs.drive import Drive, drive_from_log
from offpiste.logs.log import Log
from offpiste.rig.edits import Edit
from offpiste.rig.labels import named_course, named_down
from offpiste.rig.rig import Rig

_LEAST_DRIVING = 6.0
"""Minimum driving time [s]; a window with its history takes 5.2 s."""
_LEAST_CRUISE = 0.2
"""Minimum cruising speed of a driven log [m/s]."""


@dataclass(frozen=True)
class Examination:
    """Results of the checks with one rig.

    Attributes:
        findings: worst first.
        recorded: the topics as recorded.
        path: the driven path; None if it cannot be estimated.
    """

    findings: tuple[Finding, ...]
    recorded: dict[str, Recorded]
    path: DrivenPath | None


def examine(log: RememberedLog, rig: Rig | None, *, given: bool, again: bool = False) -> Examination:
    """Run all channel checks.

    Args:
        rig: None if no rig could be drafted; then only topics are checked.
        given: True if the rig is given, False if drafted.
        again: True if the log was examined before with another rig.
    """
    log = log.by(rig.clock) if rig else log
    recorded, findings = read_topics(log, rig, again=again)
    topics = Topics(recorded, rig, given=given, listed=log.topics, set_back=log.set_back)
    if given:
        findings = [f for f in findings if f.where in {name or "table" for name in topics.used}]
    findings += check_topics(topics)
    path = None
    if rig is not None and not is_fatal(findings):
        more, path = _check_driving(log, topics, rig)
        findings += more
    return Examination(ranked(findings), recorded, path)


def _check_driving(log: Log, topics: Topics, rig: Rig) -> tuple[list[Finding], DrivenPath | None]:
    """Return the findings on the pose and on channels against the driven path, and the path if available."""
    pose = rig.channels["position"].topic
    findings: list[Finding] = []
    if pose in topics.inspected:
        spans = topics.inspected, pose
        findings += check_spans(*spans, used=topics.given, channels=rig.channels, silent=topics.silent)
    tilted = _check_orientation(topics.recorded, rig)
    findings += tilted
    try:
        drive = drive_from_log(log, rig)
        path = driven_path(drive)
    except OffpisteError as error:
        return [*findings, Finding("fatal", "log", error.what, "on reading it", error.how, 1.0)], None
    beside = topics.recorded[pose].fields if pose in topics.recorded else ()
    tipped = check_level(drive.channels["position"], rig, beside)
    unfit = check_position_unit(drive, path) or _check_amount(path) or (tipped if is_fatal(tipped) else [])
    if unfit:
        return findings + unfit, path
    posed = check_pose(drive, path, beginning(topics.recorded)) + tipped
    if (leap := leap_of(path)) is not None:
        path = path.longer_side(leap.time)  # the part beyond the leap is not the vehicle's motion
    posed += _check_heading(drive, path) + _check_pose_names(rig)
    findings += posed
    if is_fatal(tilted + posed):
        findings += check_control_channels(drive, path)
    else:
        findings += check_motion(topics, drive, path)
    return findings, path


def _check_heading(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Check the heading against the course; an offset that no rig entry explains may be a drift."""
    found = check_course(drive, path)
    unexplained = any(not finding.cures and finding.severity != "note" for finding in found)
    return (check_fast_drift(drive, path) if unexplained else []) or found


def _check_pose_names(rig: Rig) -> list[Finding]:
    """Compare the names of the pose's fields with the rig."""
    findings = []
    down = [field for field in rig.channels["position"].fields[2:] if named_down(field)]
    if down and rig.motion.axes not in WORLD_DOWN:
        edit, what = Edit("motion.axes", "ned"), "its third field is named down, and is read as up"
        evidence = f"'{down[0]}'; hills would be valleys"
        findings.append(fixable("warning", "position", what, evidence, (edit,), score=0.9))
    named = rig.channels["yaw"].fields if "yaw" in rig.channels else ()
    course = [field for field in named if named_course(field)]
    if course:
        what = "is a course over ground, by its name, and no heading"
        evidence = f"'{course[0]}'; sliding cannot be seen in it, backwards looks like forwards, at rest it is noise"
        findings.append(Finding("note", "yaw", what, evidence, "take a heading where one is recorded", 0.3))
    return findings


def _check_orientation(recorded: dict[str, Recorded], rig: Rig) -> list[Finding]:
    source = rig.channels.get("orientation")
    if source is None or source.topic not in recorded or not set(source.fields) <= set(recorded[source.topic].fields):
        return []
    r = recorded[source.topic]
    return check_orientation(r.values[:, [r.fields.index(field) for field in source.fields]], rig)


def _check_amount(path: DrivenPath) -> list[Finding]:
    """Return a finding if there is too little driving."""
    if path.driving >= _LEAST_DRIVING and path.cruise >= _LEAST_CRUISE:
        return []
    evidence = f"{path.driving:.1f} s faster than {MOVING} m/s, {path.distance:.1f} m, 95 % of the speeds below "
    evidence += f"{path.cruise:.2f} m/s"
    what = "hardly moves" if path.driving < 1 else "is driven for too short a time"
    return [Finding("fatal", "position", what, evidence, "record more driving, or fix channels.position", 1.0)]
