"""Pose and velocities of a first rig: selection of topics by names, types and values."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import LogError, OffpisteError
from offpiste.inspection.course import check_course
from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.findings import Cure, Finding
from offpiste.inspection.naming import Guess, by_topic, field_values, w_comes_first
from offpiste.inspection.pose import check_orientation, check_position_unit
from offpiste.inspection.pose_samples import check_level
from offpiste.inspection.signal_faults import degrees_each
from offpiste.inspection.usual_ranges import RANGES
from offpiste.logs.channel import read_channel
from offpiste.logs.drive import drive_from_log
from offpiste.logs.log import Log
from offpiste.rig.channels import GEOGRAPHIC
from offpiste.rig.edits import edited
from offpiste.rig.labels import channel_unit, is_named, named_course, named_down
from offpiste.rig.rig import Rig

POSE_CHANNELS: Final = ("position", "orientation", "yaw", "linear_velocity", "angular_velocity")
_DENSE: Final = 4.0
"""Rate below which a pose has lower priority [1/s]."""
_EASTING: Final = 1e6
"""Threshold between projected and Earth-centred coordinates; northings may exceed it [m]."""
_RATES: Final = {"angular_velocity", "yaw_rate"}


@dataclass(frozen=True)
class Entry:
    """A channel of a first rig.

    Attributes:
        settings: entries of the rig's channel besides topic and fields.
        note: what was inferred, besides the reason of the guess.
        max_angle: road wheel angle at a steering command of 1 [rad], if this channel states it, otherwise 0.
    """

    guess: Guess
    settings: Mapping[str, Any]
    note: str = ""
    max_angle: float = 0.0


def choose_pose(log: Log, guesses: Sequence[Guess]) -> dict[str, Guess]:
    """Return the topic with the most pose and velocity channels, completed by the IMU or other topics.

    If no topic has both position and heading, e.g. a GNSS receiver with an IMU, they come from separate topics, and the
    heading may be a course over ground. Poses in the Earth-centred frame are a last resort.

    Returns:
        Guesses by channel; empty without a position or a heading.
    """
    usable = [g for g in guesses if g.channel not in POSE_CHANNELS or varies(field_values(log, g))]
    channels_of = by_topic(sorted(usable, key=_is_course))
    on_ground = {t: each for t, each in channels_of.items() if not _is_earth_centred(log, each.get("position"))}
    best = _whole_pose(log, on_ground)
    if not _has_heading(best):
        apart = _frequent(log, on_ground, ("position",), ("orientation", "yaw"))
        best = apart if _has_heading(apart) or not best else best
    best = best or _whole_pose(log, channels_of)
    if best and not _RATES & set(best):
        imus = {t: each for t, each in channels_of.items() if "imu" in log.topics[t].type.lower()}
        best |= _frequent(log, imus, ("angular_velocity",))
    if best and "linear_velocity" not in best:
        slips = ("odometry", "wheels", "earth", "commanded")
        others = {t: each for t, each in channels_of.items() if not any(is_named(kind, t) for kind in slips)}
        best |= _frequent(log, others, ("linear_velocity",))
    return best


def draft_pose(log: Log, guesses: Sequence[Guess], frame: str) -> dict[str, Entry]:
    """Return entries of the pose and the velocities (`choose_pose`).

    Args:
        frame: of the linear velocity.
    """
    best = choose_pose(log, guesses)
    entries: dict[str, Entry] = {}
    for channel in POSE_CHANNELS:
        if channel not in best or (channel == "yaw" and "orientation" in best):  # includes the heading
            continue
        guess = best[channel]
        settings, note = unit_setting(channel, guess), f"from {log.topics[guess.topic].type}"
        values = field_values(log, guess)
        if channel == "orientation" and values is not None and w_comes_first(guess.fields, values):
            guess, note = replace(guess, fields=(*guess.fields[1:], guess.fields[0])), f"{note}; w comes first"
        elif channel == "position" and guess.unit == GEOGRAPHIC and values is not None:
            if (each := degrees_each(values[:, 0], values[:, 1])) != 1:
                guess, settings["scale"] = replace(guess, fields=guess.fields[:2]), float(f"{each:.12g}")
        elif channel == "linear_velocity":
            down = len(guess.fields) == 3 and named_down(guess.fields[2])
            if down and not any(map(named_down, entries["position"].guess.fields)):
                guess = replace(guess, fields=(guess.fields[1], guess.fields[0]))  # swap to the axes of a z-up position
            settings["frame"] = frame
            note += "" if frame == "unknown" else "; frame by the pose"
        elif channel == "angular_velocity":
            settings["frame"], note = "body", f"{note}; in the body's frame, as gyroscopes measure"
        elif channel == "yaw" and not guess.unit and values is not None:
            settings |= degrees(values[:, 0])
        entries[channel] = Entry(guess, settings, note)
    return entries


def _whole_pose(log: Log, channels_of: Mapping[str, Mapping[str, Guess]]) -> dict[str, Guess]:
    """Return the topic with the most pose and velocity channels, then the highest rate, then the first in the log.

    Slow or incomplete topics have lower priority, and wheel odometry, which slips, comes after corrected poses.
    """
    whole = {topic: channels_of[topic] for topic in log.topics if topic in channels_of}
    whole = {topic: each for topic, each in whole.items() if "position" in each and {"orientation", "yaw"} & set(each)}
    spans = {topic: _span(log, topic) for topic in whole}
    longest = max(spans.values(), default=0.0)
    often = [t for t, span in spans.items() if log.topics[t].count > _DENSE * longest and span >= longest / 2]
    corrected = any(is_named("corrected", topic) and _has_heading(whole[topic]) for topic in often)

    def score(topic: str) -> tuple[bool, bool, bool, int, bool, int]:
        last = is_named("wheels", topic)
        drifts = corrected and (last or is_named("odometry", topic)) and not is_named("corrected", topic)
        kinds = sum(channel in POSE_CHANNELS for channel in whole[topic])
        return topic in often, _has_heading(whole[topic]), not drifts, kinds, not last, log.topics[topic].count

    return dict(whole[max(spans, key=score)]) if spans else {}


def _span(log: Log, topic: str) -> float:
    """Return the time from a topic's first to its last message [s]."""
    time = log.stamps(topic)
    time = time[np.isfinite(time)]
    return float(np.ptp(time)) if len(time) else 0.0


def _has_heading(channels: Mapping[str, Guess]) -> bool:
    """Return True if the channels include the vehicle's heading; a course over ground does not count."""
    return "orientation" in channels or ("yaw" in channels and not _is_course(channels["yaw"]))


def _is_course(guess: Guess) -> bool:
    """Return True if a heading is a course over ground, used only as a fallback."""
    return guess.channel == "yaw" and named_course(guess.fields[0])


def _is_earth_centred(log: Log, place: Guess | None) -> bool:
    """Return True if a position is Earth-centred by its name or its values."""
    if place is None or place.unit == GEOGRAPHIC:
        return False
    values, (least, most) = field_values(log, place), RANGES["earth"]
    middle = np.zeros(3) if values is None else np.sort(np.abs(np.median(values, axis=0)))
    far = least < float(np.linalg.norm(middle)) < most and len(middle) > 2 and middle[1] > _EASTING
    return is_named("earth", place.topic) or bool(far)


def _frequent(log: Log, channels_of: Mapping[str, Mapping[str, Guess]], *kinds: tuple[str, ...]) -> dict[str, Guess]:
    """Return a guess for each kind of channels, from the topics with the most samples; empty if one is missing."""
    often = sorted(channels_of, key=lambda topic: -log.topics[topic].count)
    guesses = sorted((guess for topic in often for guess in channels_of[topic].values()), key=_is_course)
    found = [next((guess for guess in guesses if guess.channel in kind), None) for kind in kinds]
    return {guess.channel: guess for guess in found if guess is not None} if all(found) else {}


def unit_setting(channel: str, guess: Guess) -> dict[str, Any]:
    """Return the unit stated by the log if it is valid for the channel and not the default."""
    unit = channel_unit(channel, guess.unit)
    return {"unit": unit} if unit else {}


def degrees(values: Float[np.ndarray, " n"]) -> dict[str, Any]:
    """Return the unit of an angle too large for radians.

    Autopilots use hundredths of a degree, and u-blox receivers 1e-5 degrees.
    """
    largest, spanned = np.abs(values).max(), np.ptp(values)
    if spanned > 20 and largest <= 361:
        return {"unit": "deg"}
    whole = bool((values == np.round(values)).all())
    for each in (1e-2, 1e-5):
        if whole and spanned > 20 / each and largest <= 361 / each:
            return {"scale": each, "unit": "deg"}
    return {}


def varies(values: Float[np.ndarray, "n k"] | None) -> bool:
    """Return True if a field has rows that are not all equal."""
    return values is not None and bool(np.ptp(values, axis=0).max() > 0)


def points_down(log: Log, pose: Guess) -> bool:
    """Return True if a position is north-east-down by its names or its message type."""
    first = first_message(log, pose.topic)
    frames = getattr(getattr(first, "header", None), "frame_id", ""), getattr(first, "child_frame_id", "")
    names = (pose.topic or log.path.name, *pose.fields, *map(str, frames))
    named = is_named("ned", *names) or any(map(named_down, pose.fields))
    return named or is_named("ned_types", log.topics[pose.topic].type)


def first_message(log: Log, topic: str) -> Any:
    """Return the first message of a topic; None if the topic is empty or the log has no messages."""
    try:
        return next((message for _, message in log.messages(topic)), None)
    except LogError:
        return None


def pose_cure(log: Log, rig: Rig) -> Cure:
    """Return edits of a first rig for quaternion order, z up, positions in metres and headings along the course.

    Games and motion capture may have y up, and compass headings are clockwise.
    """
    try:
        source = rig.channels["position"]
        tipped = check_level(read_channel(log, rig, "position", source)[0], rig, log.topics[source.topic].fields)
        turned = rig.channels.get("orientation")
        stored = check_orientation(log.read(turned.topic, turned.fields).values, rig) if turned else []
        upright = (*_first_cure(stored), *_first_cure(tipped))
        drive = drive_from_log(log, edited(rig, upright))
        path = driven_path(drive)
        if in_metres := _first_cure(check_position_unit(drive, path)):
            drive = drive_from_log(log, edited(rig, (*upright, *in_metres)))
            path = driven_path(drive)
        return (*upright, *in_metres, *_first_cure(check_course(drive, path)))
    except OffpisteError:
        return ()


def _first_cure(findings: Sequence[Finding]) -> Cure:
    return next((cure for finding in findings for cure in finding.cures), ())
