"""Run of all channel checks on a log with one rig."""

from dataclasses import dataclass

from offpiste.core.errors import OffpisteError
from offpiste.inspection.checks import Topics, check_motion, check_topics
from offpiste.inspection.course import check_course
from offpiste.inspection.driven_path import MOVING, DrivenPath, driven_path
from offpiste.inspection.findings import Finding, found, is_fatal, ranked, unreadable
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
        return [*findings, unreadable("log", error)], None
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
        findings.append(found("named_down", "position", {"field": down[0]}, (Edit("motion.axes", "ned"),)))
    named = rig.channels["yaw"].fields if "yaw" in rig.channels else ()
    course = [field for field in named if named_course(field)]
    if course:
        findings.append(found("heading_of_course", "yaw", {"field": course[0]}))
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
    about = {"driving": path.driving, "moving": MOVING, "distance": path.distance, "cruise": path.cruise}
    return [found("hardly_moves" if path.driving < 1 else "short_drive", "position", about)]
