"""Controls that no name gives away: fields that the vehicle's motion follows, such as the axes of a joystick."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import Final

import msgspec
import numpy as np
from jaxtyping import Float

from offpiste.core.errors import OffpisteError
from offpiste.inspection.channel_guesses import Guess, labels
from offpiste.inspection.commanded_motion import is_asked_for
from offpiste.inspection.driven_path import DrivenPath, driven_path
from offpiste.inspection.lags import LAGS, LagFit, fit_lags, lagged
from offpiste.inspection.pedals import pedal_fit
from offpiste.inspection.steering_fit import moving_rows, steering_fit
from offpiste.inspection.usual_ranges import are_pulses, is_signed, pulse_at_rest, rests_between, rests_high
from offpiste.logs.channel import Channel, read_channel
from offpiste.logs.drive import drive_from_log
from offpiste.logs.log import Log, Topic
from offpiste.rig.channels import ChannelSource
from offpiste.rig.labels import COMMANDED
from offpiste.rig.rig import Rig

_FOLLOWS: Final = {"steer": 0.75, "throttle": 0.45, "brake": 0.35}
"""Least correlation with the turning or the acceleration for a control that its numbers alone show."""
_CLEARER: Final = 0.1
"""By this much more than the next field."""
_LEADS: Final = {"steer": (-0.05, 0.6), "throttle": (-0.05, 0.8), "brake": (-0.05, 0.8)}
"""How long after a command the motion comes [s]: what moves before it is measured."""
_COPIES: Final = 0.95
"""Correlation of two fields that are one steering, commanded and measured."""
_SAME: Final = 0.999
"""Correlation of two fields at the same moments that are one control, written down twice."""
_WHOLE: Final = 1.05
"""Largest number of a control that is a share."""
_APART: Final = np.arange(-0.6, 0.61, 0.02)
"""Lags of the one behind the other that are tried [s]."""
_NEARLY: Final = 0.95
"""Share of the best correlation that counts as the best: slow signals hardly tell when."""
_AT_ONCE: Final = 0.1
"""Wheels take longer to turn, and vehicles to follow them [s]."""
_MOST: Final = 24
"""Most fields that are tried."""
_OF_MOTION: Final = re.compile(r"linear|angular")
"""Names of the fields of a commanded motion."""
_MEASURED: Final = re.compile(
    r"odom|gps|gnss|navsat|twist|accel|magn|image|scan|(?<![a-z])(?:imu|pose|point|tf(?![a-z]))", re.IGNORECASE
)
"""Topics and types of what is measured."""
_COMMANDING: Final = re.compile(rf"{COMMANDED.pattern}|actuator|motors", re.IGNORECASE)
"""Topics of commands to a vehicle, or to its actuators."""
_BY_HAND: Final = re.compile(r"(?<![a-z])(joy(stick)?|gamepad|teleop|radio|rc(_?in)?)(?![a-z])", re.IGNORECASE)
"""Topics of what a person drives with at a distance: sticks, and triggers that are pedals."""
_GOES_OUT: Final = re.compile(r"(?<![a-z])(rc)?out?(puts?)?(?![a-z])", re.IGNORECASE)
"""Topics of what a flight controller gives its actuators, whatever came in by radio."""
_SIDES: Final = {"left": "right", "right": "left"}
_SIDE: Final = re.compile(r"(?<![a-z])(left|right)(?![a-z])", re.IGNORECASE)
"""Names of the two sides of a vehicle, whose wheels or tracks have a command each."""
_STEERING: Final = re.compile(r"steer|joy|com+and|cmd|control", re.IGNORECASE)
"""Topics that may hold a steering, whatever its field is called."""
_LISTED: Final = 60
"""Columns of a table that are named."""
_FRAME: Final = re.compile(r"can_msgs/(msg/)?Frame$")
"""Messages of bytes as they come on a CAN bus."""
_MOTION: Final = re.compile(
    r"acc|gyro|omega|rate|vel|speed|pos|orient|quat|cov|curv|slip|wheel|rpm|yaw|pitch|roll|(?<![a-z])[xyz](?![a-z])"
)
"""Names of numbers that follow from the motion, and not the motion from them."""


def find_controls(log: Log, rig: Rig) -> dict[str, tuple[Guess, float]]:
    """Controls that a rig lacks, by the motion that follows them: where each is, and the correlation.

    Args:
        rig: with a pose.
    """
    lacking = [name for name in _FOLLOWS if name not in rig.channels]
    if not lacking:
        return {}
    try:
        path = driven_path(drive_from_log(log, rig))
    except OffpisteError:
        return {}
    fields = list(islice(_candidates(log, rig), _MOST))
    found: dict[str, tuple[Guess, float]] = {}
    for name in lacking:
        taken = {(guess.topic, guess.fields) for guess, _ in found.values()}
        left = [guess for guess in fields if (guess.topic, guess.fields) not in taken]
        if name != "steer":
            topics = {found["steer"][0].topic} if "steer" in found else set()
            left = [guess for guess in left if guess.topic in topics or _may_hold_pedals(guess.topic)]
        scores = sorted(((_follows(name, guess, log, rig, path), guess) for guess in left), key=lambda pair: -pair[0])
        if not scores or scores[0][0] < _FOLLOWS[name]:
            continue
        near = [(score, guess) for score, guess in scores if scores[0][0] - score < _CLEARER]
        near = _without_copies(near, name, log, rig)
        if name == "steer" and len(near) == 2:
            found |= _commanded_and_measured(near, log, rig)
        elif len(near) == 1:
            score, guess = near[0]
            found[name] = replace(guess, channel=name), score
    return found


def _may_hold_pedals(topic: str) -> bool:
    """Whether a topic is a command or a remote control by its name: too much else goes up and down with the speed."""
    return bool(_COMMANDING.search(topic) or _BY_HAND.search(topic))


def _without_copies(near: Sequence[tuple[float, Guess]], name: str, log: Log, rig: Rig) -> list[tuple[float, Guess]]:
    """The same but for fields that are another one at the same moment in other numbers, as pulses of its command.

    Of these the one whose numbers are a share, within -1 to 1, is kept, else what goes out to the actuators.
    """
    kept = list[tuple[float, Guess, Channel]]()
    read = [(score, guess, channel) for score, guess in near if (channel := _read(name, guess, log, rig)) is not None]
    read.sort(key=lambda one: (float(np.abs(one[2].values).max()) > _WHOLE, not _GOES_OUT.search(one[1].topic)))
    for score, guess, channel in read:
        at = channel.time[:: max(len(channel.time) // 2000, 1)]
        others = (np.interp(at, other.time, other.values[:, 0]) for _, _, other in kept)
        own = np.interp(at, channel.time, channel.values[:, 0])
        if not any(abs(np.corrcoef(own, other)[0, 1]) > _SAME for other in others):
            kept.append((score, guess, channel))
    return [(score, guess) for score, guess, _ in kept]


def _commanded_and_measured(pair: Sequence[tuple[float, Guess]], log: Log, rig: Rig) -> dict[str, tuple[Guess, float]]:
    """Two fields that are one steering: the earlier is its command, the later what was measured; nothing for others."""
    samples = [channel for _, guess in pair if (channel := _read("steer", guess, log, rig)) is not None]
    start, end = max(s.time[0] for s in samples), min(s.time[-1] for s in samples)
    at = np.arange(start + _APART[-1], end - _APART[-1], 0.02)
    if len(at) < 100:
        return {}
    one = np.interp(at, samples[0].time, samples[0].values[:, 0])
    others = [np.interp(at + lag, samples[1].time, samples[1].values[:, 0]) for lag in _APART]
    alike = np.array([abs(np.corrcoef(one, other)[0, 1]) for other in others])
    lag = float(_APART[alike.argmax()])
    if alike.max() < _COPIES or abs(lag) < 0.01:
        return {}
    first, second = pair if lag > 0 else reversed(pair)
    return {name: (replace(guess, channel=name), score)
            for name, (score, guess) in (("steer", first), ("steer_angle", second))}  # fmt: skip


def _follows(name: str, guess: Guess, log: Log, rig: Rig, path: DrivenPath) -> float:
    """Correlation of the motion with a field as this control, later than it; 0 where it does not follow."""
    trial = _with(name, guess, rig)
    channel = _read(name, guess, log, rig)
    if channel is None:
        return 0.0
    if name == "steer":
        fitted = steering_fit(channel, path, trial, measured=False)
        if fitted is None or _is_turn_rate(channel, path, trial, fitted.steady.strength):
            return 0.0
        return _later(fitted.steady, name, sign=0)
    pressed = _pressed(channel)
    fit = None if pressed is None else pedal_fit(pressed, None, path, trial)
    return 0.0 if fit is None else _later(fit, name, sign=1 if name == "throttle" else -1)


def _with(name: str, guess: Guess, rig: Rig) -> Rig:
    """A rig that reads a field as this control."""
    source = ChannelSource(guess.fields, guess.topic)
    return msgspec.structs.replace(rig, channels={**rig.channels, name: source})


def _read(name: str, guess: Guess, log: Log, rig: Rig) -> Channel | None:
    """A field as this control, without what is not finite or out of order; None where nothing usable is left."""
    trial = _with(name, guess, rig)
    try:
        return read_channel(log, trial, name, trial.channels[name])[0]
    except OffpisteError:
        return None


def _is_turn_rate(channel: Channel, path: DrivenPath, rig: Rig, strength: float) -> bool:
    """Whether a field explains the yaw rate of that moment alone, as a gyroscope does, no less than times the speed.

    Args:
        strength: its correlation times the speed.
    """
    one = np.ones((len(path.time), 1))
    fit = fit_lags(path.yaw_rate, one, lagged(channel, path.time, rig), LAGS, moving_rows(path))
    return fit is not None and fit.strength >= strength and abs(float(fit.lags[fit.best()])) < _AT_ONCE


def _pressed(channel: Channel) -> Channel | None:
    """A pedal from 0, released, upwards, or what lies above the middle of a stick or of pulses; None for neither."""
    values: Float[np.ndarray, "n 1"] = channel.values
    high, pulses = rests_high(values[:, 0]), are_pulses(values[:, 0], named=False)
    rest = pulse_at_rest(values[:, 0]) if pulses else 0.0
    two_way = rests_between(values[:, 0], rest) and (pulses or is_signed(values[:, 0]))
    # Whoever drives at full throttle for long is at an end of the range as well.
    if high is None or two_way:
        both_ways = channel.name == "throttle" and (pulses or is_signed(values[:, 0]))
        return replace(channel, values=np.maximum(values - rest, 0.0)) if both_ways else None
    return Channel(channel.name, channel.unit, channel.time, values.max() - values if high else values - values.min())


def _later(fit: LagFit, name: str, *, sign: int) -> float:
    """The correlation with motion that comes later; 0 where motion that comes before explains clearly more."""
    best, inside = fit.best(sign=sign), fit.best(*_LEADS[name], sign=sign)
    return float(abs(fit.r[inside])) if abs(fit.r[inside]) >= _NEARLY * abs(fit.r[best]) else 0.0


def is_measured_topic(topic: Topic) -> bool:
    """Whether name or type of a topic say that it is measured; a table's columns say more than its name.

    A topic named as a command is none, as TartanDrive's `cmd/twist.npy`, but for one that commands a motion.
    """
    if COMMANDED.search(topic.name) and not any(_OF_MOTION.search(field) for field in topic.fields):
        return False
    return bool(topic.name and _MEASURED.search(f"{topic.name} {topic.type}"))


def _candidates(log: Log, rig: Rig) -> Iterator[Guess]:
    """Fields that no channel reads, that change, and that no name says to be measured; those of commands come first."""
    for guess in sorted(_unread(log, rig), key=lambda guess: not (guess.asked_for or _COMMANDING.search(guess.topic))):
        try:
            values = log.read(guess.topic, guess.fields).values[:, 0]
        except OffpisteError:
            continue
        values = values[np.isfinite(values)]
        if len(values) > 100 and len(np.unique(values)) > 4 and not (np.diff(values) >= 0).all():
            yield guess


def _unread(log: Log, rig: Rig) -> Iterator[Guess]:
    """Fields that no channel reads and that no name says to be measured, in the log's order."""
    read = {(source.topic, field) for source in rig.channels.values() for field in source.fields}
    for topic in log.topics.values():
        if topic.count < 100 or topic.part_of or is_measured_topic(topic) or _FRAME.search(topic.type):
            continue
        sides = _sides(topic, log)
        for field, label in labels(topic).items():
            asked = COMMANDED.search(topic.name) or COMMANDED.search(label.name)
            moved = not asked and _MOTION.search(label.name.rpartition("/")[2])
            if (topic.name, field) not in read and field not in (log.clock.column, *sides) and not moved:
                yield Guess("", topic.name, (field,), label.unit, asked_for=is_asked_for(topic, (field,)))


def _sides(topic: Topic, log: Log) -> list[str]:
    """Fields of one side of the vehicle that have a counterpart of the other side: one alone neither drives nor steers.

    The side is in the names of the fields, or in that of the topic.
    """
    fields = [field for field in topic.fields if _other_side(field) in topic.fields]
    return fields or (list(topic.fields) if _other_side(topic.name) in log.topics else [])


def _other_side(name: str) -> str | None:
    """The same name of the other side; None where it names no side."""
    other = _SIDE.sub(lambda side: _SIDES[side[0].lower()], name)
    return None if other == name else other


def why_no_steering(log: Log) -> str:
    """Sentences on what holds a steering that cannot be read as it is: commands of two sides, raw bytes; or none."""
    sided: list[str] = []
    words = ""
    for topic in log.topics.values():
        if not topic.part_of and not is_measured_topic(topic):
            fields = [field for field in _sides(topic, log) if _COMMANDING.search(f"{topic.name} {field}")]
            sided += [f"{topic.name} {field}".strip() for field in fields]
        if _FRAME.search(topic.type):
            words += f"{topic.name} holds raw CAN frames: decode them with the DBC of the vehicle first. "
    if sided:
        words += f"{', '.join(sided[:4])} drive one side of the vehicle each: log their difference as the steering, "
        words += "and their mean as the throttle. "
    return words


def steering_candidates(log: Log) -> str:
    """Sentences on numbers that may be the steering under another name, and on what holds one that cannot be read."""
    why = why_no_steering(log)
    if list(log.topics) == [""]:
        return f"{why}The columns are: {', '.join(log.topics[''].fields[:_LISTED])}"
    others = [t for t in log.topics.values() if t.fields and not (t.part_of or is_measured_topic(t))]
    topics = [topic for topic in others if _STEERING.search(topic.name)] or others
    named = [f"{topic.name} ({', '.join(map(topic.in_words, topic.fields[:8]))})" for topic in topics]
    return why + (f"It may be in: {'; '.join(named)}" if named else "All topics are named like measurements.")
