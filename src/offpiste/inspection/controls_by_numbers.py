"""Controls without telling names, found by the vehicle's response, e.g. joystick axes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final

import msgspec
import numpy as np
from jaxtyping import Float

from offpiste.core.errors import OffpisteError
from offpiste.inspection.naming import Guess, labels
from offpiste.inspection.commanded_motion import is_commanded
from offpiste.inspection.driven_path import STEP, DrivenPath, driven_path
from offpiste.inspection.lags import LAGS, LagFit, fit_lags
from offpiste.inspection.response import PRIORS, pedal_fit, steering_fit, turn_rate_fit
from offpiste.inspection.usual_ranges import are_pulses, is_signed, pulse_at_rest, rests_between, rests_high
from offpiste.logs.channel import Channel, read_channel
from offpiste.logs.drive import drive_from_log
from offpiste.logs.log import Log, Topic
from offpiste.rig.channels import ChannelSource
from offpiste.rig.labels import PATTERNS, is_named
from offpiste.rig.rig import Rig

_FOLLOWS: Final = {"steer": 0.75, "throttle": 0.45, "brake": 0.35}
"""Minimum correlation of an unnamed control with the turning or the acceleration."""
_CLEARER: Final = 0.1
"""Minimum margin over the next field's correlation."""
_LEADS: Final = {"steer": (-0.05, 0.6), "throttle": (-0.05, 0.8), "brake": (-0.05, 0.8)}
"""Allowed response time of the motion [s]; signals that lag the motion are measurements."""
_COPIES: Final = 0.95
"""Minimum correlation of commanded and measured steering."""
_SAME: Final = 0.999
"""Minimum correlation of simultaneous copies of one control."""
_WHOLE: Final = 1.05
"""Maximum value of a normalised control."""
_NEARLY: Final = 0.95
"""Share of the best correlation that counts as equal; slow signals determine the lag poorly."""
_AT_ONCE: Final = 0.1
"""Maximum lag of a simultaneous measurement; wheels and vehicles respond later [s]."""
_MOST: Final = 24
"""Maximum number of candidate fields."""
_SIDES: Final = {"left": "right", "right": "left"}
"""Vehicle sides with separate commands per wheel or track."""
_LISTED: Final = 60
"""Maximum number of table columns listed."""


@dataclass(frozen=True)
class _Candidate:
    """A field read as a control.

    Attributes:
        score: correlation of the later motion with it; 0 if the motion does not follow it.
        on_path: values at the times of the driven path.
    """

    guess: Guess
    score: float
    on_path: Float[np.ndarray, " n"]


def find_controls(log: Log, rig: Rig) -> dict[str, tuple[Guess, float]]:
    """Return controls missing from a rig, found by the vehicle's response, with their correlations.

    Args:
        rig: must have a pose.
    """
    lacking = [name for name in _FOLLOWS if name not in rig.channels]
    if not lacking:
        return {}
    try:
        path = driven_path(drive_from_log(log, rig))
    except OffpisteError:
        return {}
    fields = list(islice(_fields(log, rig), _MOST))
    found: dict[str, tuple[Guess, float]] = {}
    for name in lacking:
        taken = {(guess.topic, guess.fields) for guess, _ in found.values()}
        left = [guess for guess in fields if (guess.topic, guess.fields) not in taken]
        if name != "steer":
            topics = {found["steer"][0].topic} if "steer" in found else set()
            left = [guess for guess in left if guess.topic in topics or _may_hold_pedals(guess.topic)]
        read = [one for guess in left if (one := _candidate(name, guess, log, rig, path)) is not None]
        best = max((one.score for one in read), default=0.0)
        if best < _FOLLOWS[name]:
            continue
        near = _without_copies([one for one in read if best - one.score < _CLEARER])
        names = [name] if len(near) == 1 else []
        if name == "steer" and len(near) == 2:
            near, names = _in_order(near), ["steer", "steer_angle"]
        found |= {name: (replace(one.guess, channel=name), one.score) for name, one in zip(names, near, strict=False)}
    return found


def _may_hold_pedals(topic: str) -> bool:
    """Return True if a topic is named as a command or remote control; too many other fields follow the speed."""
    return is_named("to_actuators", topic) or is_named("remote_controls", topic)


def _candidate(name: str, guess: Guess, log: Log, rig: Rig, path: DrivenPath) -> _Candidate | None:
    """Read a field as a control, without rows that are not finite or out of order; None if nothing is left."""
    source = ChannelSource(guess.fields, guess.topic)
    trial = msgspec.structs.replace(rig, channels={**rig.channels, name: source})
    try:
        channel = read_channel(log, trial, name, source)[0]
    except OffpisteError:
        return None
    at = np.interp(path.time, channel.time, channel.values[:, 0])
    if name == "steer":
        fitted = steering_fit(channel, path, trial)
        turn_rate = turn_rate_fit(channel, path, trial, fitted)  # like a gyroscope, if at once
        at_once = turn_rate is not None and abs(turn_rate.lags[turn_rate.best()]) < _AT_ONCE
        fit = None if fitted is None or at_once else fitted.steady
    else:
        pressed = _pressed(channel)
        fit = None if pressed is None else pedal_fit(pressed, None, path, trial)
    return _Candidate(guess, 0.0 if fit is None else _later(fit, name), at)


def _later(fit: LagFit, name: str) -> float:
    """Return the correlation with later motion; 0 if earlier motion is a clearly better explanation."""
    sign = PRIORS[name].sign
    best, inside = fit.best(sign=sign), fit.best(*_LEADS[name], sign=sign)
    return float(abs(fit.r[inside])) if abs(fit.r[inside]) >= _NEARLY * abs(fit.r[best]) else 0.0


def _without_copies(near: Sequence[_Candidate]) -> list[_Candidate]:
    """Drop fields that duplicate another one at the same time in other units, e.g. command pulses.

    The field within -1 to 1 is kept, otherwise the actuator output.
    """
    kept: list[_Candidate] = []
    order = sorted(near, key=lambda one: (np.abs(one.on_path).max() > _WHOLE, not is_named("outputs", one.guess.topic)))
    for one in order:
        if not any(abs(np.corrcoef(one.on_path, other.on_path)[0, 1]) > _SAME for other in kept):
            kept.append(one)
    return kept


def _in_order(pair: Sequence[_Candidate]) -> list[_Candidate]:
    """Return two fields of one steering, first the command, which is earlier; none if they differ or coincide."""
    first, second = pair
    rows = np.rint(LAGS / STEP).astype(int)
    earlier = np.stack([np.roll(first.on_path, row) for row in rows])
    inside = np.ones(len(first.on_path), bool)
    inside[: rows[-1]] = inside[len(inside) - rows[-1] :] = False
    fit = fit_lags(second.on_path, np.ones((len(inside), 1)), earlier, LAGS, inside)
    if fit is None or fit.strength < _COPIES or abs(lag := fit.delay(fit.best())[0]) < 0.01:
        return []
    return [first, second] if lag > 0 else [second, first]


def _pressed(channel: Channel) -> Channel | None:
    """Return a pedal from 0 upwards, or the upper half of a stick or pulses; None if neither fits."""
    values: Float[np.ndarray, "n 1"] = channel.values
    high, pulses = rests_high(values[:, 0]), are_pulses(values[:, 0], named=False)
    rest = pulse_at_rest(values[:, 0]) if pulses else 0.0
    two_way = rests_between(values[:, 0], rest) and (pulses or is_signed(values[:, 0]))
    # Long driving at full throttle is also at an end of the range.
    if high is None or two_way:
        both_ways = channel.name == "throttle" and (pulses or is_signed(values[:, 0]))
        return replace(channel, values=np.maximum(values - rest, 0.0)) if both_ways else None
    return Channel(channel.name, channel.unit, channel.time, values.max() - values if high else values - values.min())


def is_measured_topic(topic: Topic) -> bool:
    """Return True if a topic's name or type marks a measurement; for tables, the columns decide.

    Topics named as commands are excluded, such as TartanDrive's `cmd/twist.npy`, unless they command a motion.
    """
    if is_named("commanded", topic.name) and not is_named("of_motion", *topic.fields):
        return False
    return bool(topic.name) and is_named("measured_topics", f"{topic.name} {topic.type}")


def _fields(log: Log, rig: Rig) -> Iterator[Guess]:
    """Yield unused varying fields not named as measurements, commands first."""
    unread = list(_unread(log, rig))
    for guess in sorted(unread, key=lambda guess: not (guess.is_command or is_named("to_actuators", guess.topic))):
        try:
            values = log.read(guess.topic, guess.fields).values[:, 0]
        except OffpisteError:
            continue
        values = values[np.isfinite(values)]
        if len(values) > 100 and len(np.unique(values)) > 4 and not (np.diff(values) >= 0).all():
            yield guess


def _unread(log: Log, rig: Rig) -> Iterator[Guess]:
    """Yield unused fields not named as measurements, in log order."""
    read = {(source.topic, field) for source in rig.channels.values() for field in source.fields}
    for topic in log.topics.values():
        if topic.count < 100 or topic.part_of or is_measured_topic(topic) or is_named("can_frames", topic.type):
            continue
        sides = _sides(topic, log)
        for field, label in labels(topic).items():
            asked = is_named("commanded", topic.name, label.name)
            moved = not asked and is_named("caused", label.name.rpartition("/")[2])
            if (topic.name, field) not in read and field not in (log.clock.column, *sides) and not moved:
                yield Guess("", topic.name, (field,), label.unit, is_command=is_commanded(topic, (field,)))


def _sides(topic: Topic, log: Log) -> list[str]:
    """Return fields of one vehicle side that have a counterpart on the other side.

    The side is part of the field names or of the topic.
    """
    fields = [field for field in topic.fields if _other_side(field) in topic.fields]
    return fields or (list(topic.fields) if _other_side(topic.name) in log.topics else [])


def _other_side(name: str) -> str | None:
    """Return the name of the opposite side's counterpart; None if it names no side."""
    other = PATTERNS["sides"].sub(lambda side: _SIDES[side[0].lower()], name)
    return None if other == name else other


def why_no_steering(log: Log) -> str:
    """Return sentences on unreadable steering sources (commands per side, raw bytes), or ""."""
    sided: list[str] = []
    words = ""
    for topic in log.topics.values():
        if not topic.part_of and not is_measured_topic(topic):
            fields = [field for field in _sides(topic, log) if is_named("to_actuators", f"{topic.name} {field}")]
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
        return f"{why}The columns are: {', '.join(log.topics[''].fields[:_LISTED])}"
    others = [t for t in log.topics.values() if t.fields and not (t.part_of or is_measured_topic(t))]
    topics = [topic for topic in others if is_named("steering_topics", topic.name)] or others
    named = [f"{topic.name} ({', '.join(map(topic.in_words, topic.fields[:8]))})" for topic in topics]
    return why + (f"It may be in: {'; '.join(named)}" if named else "All topics are named like measurements.")
