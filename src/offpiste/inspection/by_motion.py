"""Fields without telling names, found by the motion: a heading by the course, controls by the vehicle's response.

Every field has a score for every channel that a first rig lacks, and one assignment maximises their sum.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product
from typing import Final

import msgspec
import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from offpiste.core.errors import OffpisteError
from offpiste.core.geometry import local_from_geographic
from offpiste.inspection.commanded_motion import is_commanded
from offpiste.inspection.driven_path import STEP, DrivenPath, driven_path
from offpiste.inspection.lags import LAGS, LagFit, fit_lags
from offpiste.inspection.naming import Guess, field_values, is_measured_topic, labels, of_one_side
from offpiste.inspection.response import PRIORS, pedal_fit, steering_fit, turn_rate_fit
from offpiste.inspection.usual_ranges import is_signed, pulse_at_rest, rests_between, rests_high
from offpiste.logs.channel import Channel, read_channel
from offpiste.logs.drive import drive_from_log
from offpiste.logs.log import Log, Samples
from offpiste.rig.channels import GEOGRAPHIC, ChannelSource, unit_factor
from offpiste.rig.labels import is_named
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
_APART: Final = 0.5
"""Time between two positions that define the course [s]."""
_LEAST: Final = 20
"""Minimum number of such position pairs."""
_ALONG: Final = 0.95
"""Minimum resultant of course minus heading for an unnamed heading, ..."""
_ONE_WAY: Final = 0.8
"""... and the maximum of the course itself; on a straight any near-constant field fits."""


def find_heading(log: Log, place: Guess) -> Guess | None:
    """Return the field that follows a position's course; None if none does, or on a straight.

    It may be clockwise or counter-clockwise with any zero direction, in radians or degrees.
    """
    time, xy = _finite(log.read(place.topic, place.fields[:2]))
    at = np.arange(time[0], time[-1] - _APART, _APART) if len(time) else time
    if len(at) < _LEAST:
        return None
    if place.unit == GEOGRAPHIC:
        xy = local_from_geographic(xy)
    way = xy[_before(time, at + _APART)] - xy[_before(time, at)]
    length = np.linalg.norm(way, axis=1)
    moves = length > 0.5 * np.percentile(length, 90)
    course = np.arctan2(way[moves, 1], way[moves, 0])
    if moves.sum() < _LEAST or abs(np.exp(1j * course).mean()) > _ONE_WAY:
        return None
    found: list[tuple[float, Guess]] = []
    fields = [(name, field) for name, topic in log.topics.items() if not topic.part_of for field in topic.fields]
    for topic, field in fields:
        if field in (log.clock.column, *place.fields) or is_named("commanded", f"{topic} {field}"):
            continue
        try:
            stamps, values = _finite(log.read(topic, (field,)))
        except OffpisteError:
            continue
        if not len(values) or np.ptp(values) == 0:
            continue
        angle = values[_before(stamps, at[moves] + _APART / 2), 0]  # the last sample, as angles may wrap in between
        for sign, unit in product((1, -1), ("rad", "deg")):
            away = course - sign * unit_factor("yaw", unit) * angle
            why = "by its numbers: the course of the position follows it"
            found.append((float(abs(np.exp(1j * away).mean())), Guess("yaw", topic, (field,), unit, why=why)))
    follows, best = max(found, key=lambda pair: pair[0], default=(0.0, None))
    return best if follows > _ALONG else None


def _finite(samples: Samples) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n k"]]:
    """Return stamps and values of the finite rows, sorted by stamp."""
    known = np.isfinite(samples.time) & np.isfinite(samples.values).all(axis=1)
    order = np.argsort(samples.time[known], kind="stable")
    return samples.time[known][order], samples.values[known][order]


def _before(time: Float[np.ndarray, " n"], at: Float[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
    """Return the row of the last sample before each time."""
    return np.asarray(np.maximum(np.searchsorted(time, at) - 1, 0))


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


def find_controls(log: Log, rig: Rig) -> dict[str, Guess]:
    """Return controls missing from a rig, found by the vehicle's response.

    A steering command and its measured angle, which follows later, are found together.

    Args:
        rig: must have a pose.
    """
    lacking = [name for name in _FOLLOWS if name not in rig.channels]
    try:
        path = driven_path(drive_from_log(log, rig)) if lacking else None
    except OffpisteError:
        path = None
    if path is None:
        return {}
    fields = list(islice(_fields(log, rig), _MOST))
    read: dict[str, list[_Candidate]] = {}
    steers: set[str] = set()
    for name in lacking:
        usable = [guess for guess in fields if name == "steer" or _may_hold_pedals(guess.topic, steers)]
        read[name] = [one for guess in usable if (one := _candidate(name, guess, log, rig, path)) is not None]
        if name == "steer" and read[name]:
            best = max(read[name], key=lambda one: one.score)
            steers = {best.guess.topic} if best.score >= _FOLLOWS[name] else set()
    scores = np.zeros((len(lacking), len(fields)))
    for row, name in enumerate(lacking):
        for one in read[name]:
            scores[row, fields.index(one.guess)] = one.score if one.score >= _FOLLOWS[name] else 0.0
    pairs = zip(*linear_sum_assignment(scores, maximize=True), strict=True)
    chosen = {lacking[row]: (fields[k], scores[row, k]) for row, k in pairs if scores[row, k] > 0}
    found: dict[str, Guess] = {}
    for name, (_, score) in chosen.items():
        others = [guess for other, (guess, _) in chosen.items() if other != name]
        rivals = [one for one in read[name] if one.score > score - _CLEARER and one.guess not in others]
        near = _without_copies(rivals)
        names = [name]
        if name == "steer" and len(near) == 2:
            near, names = _in_order(near), ["steer", "steer_angle"]
        if len(near) == len(names):
            found |= {name: _found(name, one) for name, one in zip(names, near, strict=True)}
    return found


def _found(name: str, one: _Candidate) -> Guess:
    is_command = one.guess.is_command and name != "steer_angle"
    why = f"by its numbers: the motion follows it ({one.score:.2f})"
    return replace(one.guess, channel=name, is_command=is_command, why=why)


def _may_hold_pedals(topic: str, steers: set[str]) -> bool:
    """Return True for topics of steering, commands and remote controls; too many other fields follow the speed."""
    return topic in steers or is_named("to_actuators", topic) or is_named("remote_controls", topic)


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
    high, pulse = rests_high(values[:, 0]), pulse_at_rest(values[:, 0], named=False)
    rest = pulse or 0.0
    # Long driving at full throttle is also at an end of the range.
    if (pulse or is_signed(values[:, 0])) and (high is None or rests_between(values[:, 0], rest)):
        return replace(channel, values=np.maximum(values - rest, 0.0)) if channel.name == "throttle" else None
    if high is None:
        return None
    return replace(channel, values=values.max() - values if high else values - values.min())


def _fields(log: Log, rig: Rig) -> Iterator[Guess]:
    """Yield unused varying fields not named as measurements, commands first."""
    read = {(source.topic, field) for source in rig.channels.values() for field in source.fields}
    unread = []
    for topic in log.topics.values():
        if topic.count < 100 or topic.part_of or is_measured_topic(topic) or is_named("can_frames", topic.type):
            continue
        left_out = {log.clock.column, *of_one_side(topic, log)}
        for field, label in labels(topic).items():
            asked = is_named("commanded", topic.name, label.name)
            moved = not asked and is_named("caused", label.name.rpartition("/")[2])
            if (topic.name, field) not in read and field not in left_out and not moved:
                unread.append(Guess("", topic.name, (field,), label.unit, is_command=is_commanded(topic, (field,))))
    for guess in sorted(unread, key=lambda guess: not (guess.is_command or is_named("to_actuators", guess.topic))):
        values = field_values(log, guess)
        if (
            values is not None
            and len(values) > 100
            and len(np.unique(values)) > 4
            and (np.diff(values[:, 0]) < 0).any()
        ):
            yield guess
