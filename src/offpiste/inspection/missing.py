"""Missing and unused data: a log's topics and fields compared with a rig's channels, or a log without a pose."""

from collections.abc import Iterable, Iterator, Sequence
from difflib import get_close_matches
from typing import Final

import numpy as np

from offpiste.core.channels import CONTROLS
from offpiste.core.errors import LogError, OffpisteError
from offpiste.inspection.draft_pose import varies
from offpiste.inspection.findings import Finding, found
from offpiste.inspection.naming import Guess, field_values, guess_channels, is_measured_topic, of_one_side
from offpiste.inspection.recorded_log import Recorded
from offpiste.logs.log import Log
from offpiste.logs.transforms import FramePair, frame_pair, listed
from offpiste.rig.channels import POSE, ChannelSource, topic_in_words
from offpiste.rig.edits import Edit, absent
from offpiste.rig.labels import is_named, named_axis, named_coordinate
from offpiste.rig.rig import Rig

_LISTED: Final = 12
"""Maximum number of topics or fields in the evidence."""
_FIELDS: Final = 6
"""Maximum number of fields listed per topic."""
_COLUMNS: Final = 60
"""Maximum number of columns listed as possible steering."""
BY_HAND: Final = "write a rig that names one"
"""Remedy if no name indicates a pose."""


def check_missing(recorded: dict[str, Recorded], rig: Rig) -> list[Finding]:
    """Return findings on channels whose topic or fields are missing, with similar names."""
    if (nothing := _nothing(recorded, rig)) is not None:
        return [nothing]
    findings = []
    for name, source in rig.channels.items():
        r = recorded.get(source.topic)
        missing = [] if r is None else [field for field in source.fields if field not in r.fields]
        pair = frame_pair(source.topic)
        if r is not None and not missing:
            findings += [] if pair is None or not pair.is_inverse else [_inverse(name, pair)]
            continue
        cures = _cures(name, source, recorded, rig)
        if r is None:
            there = sorted(recorded, key=lambda other: pair is not None and frame_pair(other) is None)
            about = {"topic": topic_in_words(source.topic), "listed": _listed(there)}
            findings.append(found("missing_topic", name, about, *cures))
        else:
            what = r.topic.unread.get(missing[0]) or f"its topic has no field '{missing[0]}'"
            about = {"what": what, "listed": _listed(list(map(r.topic.in_words, r.topic.fields)))}
            findings.append(found("missing_field", name, about, *cures))
    return findings


def _inverse(name: str, pair: FramePair) -> Finding:
    right = FramePair(pair.topic, parent=pair.child, child=pair.parent)
    return found("inverse_pose", name, {"child": pair.child, "parent": pair.parent, "right": right.name})


def _nothing(recorded: dict[str, Recorded], rig: Rig) -> Finding | None:
    """Return a single finding on a log that has no topic of the rig, not even under a similar name."""
    if not recorded:
        return found("no_numbers", "log", {})
    topics = {source.topic for source in rig.channels.values()}
    if any(get_close_matches(topic, recorded, 1) for topic in topics):
        return None
    names = list(recorded) if any(recorded) else [field for r in recorded.values() for field in r.fields]
    return found("other_log", "log", {"listed": _listed(names)})


def _listed(there: Sequence[str]) -> str:
    return "there is: " + ", ".join(there[:_LISTED]) + (", ..." if len(there) > _LISTED else "")


def _cures(name: str, source: ChannelSource, recorded: dict[str, Recorded], rig: Rig) -> Iterator[tuple[Edit, ...]]:
    """Yield edits to similar names, and one that declares the channel absent."""
    for topic in [source.topic] if source.topic in recorded else get_close_matches(source.topic, recorded, 3):
        there = recorded[topic]
        by_joint = {joint: field for field, joint in there.topic.joints.items()}
        fields = [by_joint.get(field, field) for field in source.fields]
        if not set(fields) <= set(there.topic.fields):
            fields = _renamed(source.fields, there.topic.fields)
        if fields:
            edits = (("topic", topic, source.topic), ("fields", fields, list(source.fields)))
            yield tuple(Edit(f"channels.{name}.{key}", new) for key, new, old in edits if new != old)
    if name not in (*POSE, "steer"):
        yield absent(name, rig)


def _renamed(fields: Sequence[str], there: Sequence[str]) -> list[str]:
    """Return the most similar name of each field if all are found and distinct; otherwise nothing."""
    nearest = [f if f in there else next(iter(get_close_matches(f, there, 1)), "") for f in fields]
    return nearest if all(nearest) and len(set(nearest)) == len(nearest) else []


def check_same_pedals(rig: Rig) -> list[Finding]:
    """Return a warning if throttle and brake read the same values with the same settings, e.g. a copied entry."""
    throttle, brake = rig.channels.get("throttle"), rig.channels.get("brake")
    if throttle is None or brake is None or _as_read(throttle) != _as_read(brake):
        return []
    about = {"fields": ", ".join(throttle.fields), "topic": topic_in_words(throttle.topic)}
    return [found("same_pedals", "throttle, brake", about)]


def _as_read(source: ChannelSource) -> tuple[object, ...]:
    """Return the settings that identify a channel's source, without its limits."""
    return source.topic, source.fields, source.sign, source.scale, source.offset, source.values


def check_unread(recorded: dict[str, Recorded], rig: Rig) -> list[Finding]:
    """Return a note if the rig lacks a control although unused topics or fields are named like one."""
    lacking = [control.name for control in CONTROLS if control.name not in rig.channels]
    there = list(_unread(recorded, rig, lacking)) if lacking else []
    if not there:
        return []
    about = {"verb": "is" if len(lacking) == 1 else "are", "unread": "; ".join(there), "first": lacking[0]}
    return [found("unread_control", ", ".join(lacking), about)]


def _unread(recorded: dict[str, Recorded], rig: Rig, lacking: Sequence[str]) -> Iterator[str]:
    """Yield descriptions of unused topics and fields named like a control: topic, type and fields."""

    def named(name: str) -> bool:
        return any(is_named(f"{kind}_names", name.lower()) for kind in ("command", *lacking))

    for name, r in recorded.items():
        read = {field for source in rig.channels.values() if source.topic == name for field in source.fields}
        columns = {field: column[np.isfinite(column)] for field, column in zip(r.fields, r.values.T, strict=True)}
        still = {field for field, known in columns.items() if not len(known) or np.ptp(known) == 0}
        fields = [field for field in (r.topic.fields if name else r.fields) if field not in read | still]
        fields = [field for field in fields if not is_named("not_controls", field)]
        if read or is_measured_topic(r.topic) or not named(name):
            fields = [field for field in fields if named(r.topic.in_words(field))]
        if fields:
            listed = ", ".join(map(r.topic.in_words, fields[:_FIELDS])) + (", ..." if len(fields) > _FIELDS else "")
            yield f"{name} ({r.topic.type}: {listed})" if name else listed


def no_pose(log: Log) -> LogError:
    """Return the error for a log without a recognisable pose: available data and advice."""
    most = max((topic.count for topic in log.topics.values()), default=2)
    if most < 2 and not _not_read(log):
        has = ("the table has no rows", "the table has one row")
        if list(log.topics) != [""]:
            has = ("no topic has a message", "no topic has more than one message")
        return LogError(has[most], where=log.path, how="a drive needs many: record or export it again")
    if remedy := _pivoted(log):
        what = "the table is long: it has a line, not a column, for each signal"
        return LogError(what, where=log.path, how=remedy)
    if remedy := _from_earth(log):
        return LogError("positions in the earth's own frame (ECEF) are not read", where=log.path, how=remedy)
    how = _not_read(log) or f"{_inverse_pose(log)}{BY_HAND}"
    return LogError(
        "no topic looks like a pose (position and heading)",
        where=log.path,
        how=f"{how}; {_half_of_a_pose(log)}available: {_contents(log)}",
    )


def _half_of_a_pose(log: Log) -> str:
    """Describe the pose component that was found where the other is missing.

    Return "" if both or neither was found; a constant component does not count as found.
    """
    found = {g.channel: g for g in reversed(guess_channels(log)) if g.channel in POSE and varies(field_values(log, g))}
    place, heading = found.get("position"), found.get("orientation") or found.get("yaw")
    if (half := place or heading) is None or (place and heading):
        return ""
    kind, other = ("position", "heading") if place else ("heading", "position")
    where = f"{half.topic} ({', '.join(half.fields)})" if half.topic else ", ".join(half.fields)
    return f"{where} may be a {kind}, and no name is that of a {other}; "


def _inverse_pose(log: Log) -> str:
    """Return the start of a remedy if a transform is of the world in a body; otherwise ""."""
    for name in log.topics:
        if (pair := frame_pair(name)) is not None and pair.is_inverse:
            turned = f"{pair.topic} has it the other way round (child {pair.child} in {pair.parent}), which is not read"
            return f"{turned}: record it as nav_msgs/Odometry, or "
    return ""


def _pivoted(log: Log) -> str:
    """Return advice to pivot a long-format table to one column per signal; "" for other logs."""
    table = log.topics.get("")
    if table is None:
        return ""
    numbers = [name for name in table.fields if name != log.clock.column]
    values = numbers if len(numbers) == 1 else [name for name in numbers if is_named("signal_values", name)]
    signals = [name for name in table.unread if is_named("signal_names", name)]
    if not values or not signals:
        return ""
    columns = f"values='{values[0]}', index='{log.clock.column}', columns='{signals[0]}'"
    return f"give each name in '{signals[0]}' a column, as pandas' pivot_table({columns}) does"


def _from_earth(log: Log) -> str:
    """Return the replacement for ECEF positions; "" if no field is named as one."""
    fields = [field for topic in log.topics.values() for field in topic.fields if is_named("ecef", field)]
    if len(fields) < 3:
        return ""
    geographic = f"write latitude and longitude [deg] beside {', '.join(fields[:3])} (pyproj: EPSG:4978 to EPSG:4979)"
    return f"{geographic}, and the heading from east to north [rad]; an orientation in that frame is none"


def _not_read(log: Log) -> str:
    """Return the reason why topics cannot be read, with advice; "" if all can be read."""
    reasons = [f"{topic.name}: {topic.type}" for topic in log.topics.values() if not topic.fields and " " in topic.type]
    return f"record it as ROS messages, or write its numbers to a .csv ({'; '.join(reasons[:4])})" if reasons else ""


def _contents(log: Log) -> str:
    """Return the topics, or the columns of a log with a single table."""
    if list(log.topics) == [""]:
        text = [why for name, why in log.topics[""].unread.items() if named_coordinate(name) or named_axis(name)]
        columns = f"columns {', '.join(log.topics[''].fields) or 'without numbers'}"
        return "; ".join((columns, *text[:2]))
    return ", ".join(listed(log.topics)) or "no topic"


def why_missing(log: Log, guesses: Iterable[Guess], control: str) -> str:
    """Return the reason why a control has no field: unreadable, constant or not found."""
    for guess in (guess for guess in guesses if guess.channel in (control, f"{control}_angle")):
        try:
            log.read(guess.topic, guess.fields)
        except OffpisteError as error:
            return error.what
        values = field_values(log, guess)
        if values is not None and np.ptp(values) == 0:
            return f"{guess.topic and f'{guess.topic} '}{', '.join(guess.fields)} is always {values[0, 0]:g}"
    return "no field looks like it"


def why_no_steering(log: Log) -> str:
    """Return sentences on unreadable steering sources (commands per side, raw bytes), or ""."""
    sided: list[str] = []
    words = ""
    for topic in log.topics.values():
        if not topic.part_of and not is_measured_topic(topic):
            fields = [field for field in of_one_side(topic, log) if is_named("to_actuators", f"{topic.name} {field}")]
            sided += [f"{topic.name} {field}".strip() for field in fields]
        if is_named("can_frames", topic.type):
            words += f"{topic.name} holds raw CAN frames: decode them with the DBC of the vehicle first. "
    if sided:
        words += f"{', '.join(sided[:4])} drive one side of the vehicle each: log their difference as the steering, "
        words += "and their mean as the throttle. "
    return words


def steering_candidates(log: Log) -> str:
    """Return sentences on possible steering fields under other names, and on unreadable sources."""
    why = why_no_steering(log)
    if list(log.topics) == [""]:
        return f"{why}The columns are: {', '.join(log.topics[''].fields[:_COLUMNS])}"
    others = [t for t in log.topics.values() if t.fields and not (t.part_of or is_measured_topic(t))]
    topics = [topic for topic in others if is_named("steering_topics", topic.name)] or others
    named = [f"{topic.name} ({', '.join(map(topic.in_words, topic.fields[:8]))})" for topic in topics]
    return why + (f"It may be in: {'; '.join(named)}" if named else "All topics are named like measurements.")
