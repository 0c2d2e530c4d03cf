"""Defects of clocks: another origin or rate, a delay, a step back of all, or a drift against the wheels' speed."""

from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool

from offpiste.core.channels import control_of
from offpiste.core.errors import LogError
from offpiste.inspection.driven_path import DrivenPath
from offpiste.inspection.findings import Cure, Finding, Severity, found
from offpiste.inspection.recorded_log import Recorded, beginning, is_bulk, without_values
from offpiste.inspection.samples import field_in_words
from offpiste.logs.channel import Channel
from offpiste.logs.clock_drift import DRIFT_LIMIT, common_step, estimate_lag, least_delays
from offpiste.logs.log import Log, SetBack
from offpiste.rig.edits import Edit, rounded
from offpiste.rig.rig import Rig

RECEIVE: Final = Edit("clock.stamps", "receive")
ORIGINS: Final = 86_400.0
"""Minimum distance between clocks with different origins [s]; time zones differ by less."""
APART: Final = 0.5
"""Minimum difference in delay between header and arrival that indicates another clock [s]; sending takes less."""
DRIFT: Final = 0.1
"""Minimum drift over the log that is reported [s]."""
_STRAIGHT: Final = 0.2
"""Maximum deviation from a line, as a share of the drift, for a clock of another rate; growing delays deviate more."""
_REAL: Final = 0.02
"""Maximum rate difference of a real-time clock from the recorder's clock; simulations run at any rate."""
_BLOCKS: Final = 12
"""Number of time blocks over which the minimum delay is taken."""
_UNREAD: Final = "none: no channel reads it"
_FOLLOWS: Final = 0.97
"""Minimum correlation of a wheel speed field with the speed."""
_MAX_LAG: Final = 4.0
_LATE: Final = 0.15
"""Minimum reported lag [s]."""
_LEADS: Final = -2.0
"""Lower limit of a commanded speed's lag; vehicles respond faster than this [s]."""
_SLIP: Final = -0.6
"""Lower limit of the lags explained by wheels that spin or lock [s]."""
_CHANGE: Final = 0.3
"""Minimum change between the 5th and 95th percentile of the lag that counts as drift [s]."""


class Pace(NamedTuple):
    """Rate of a topic's clock relative to the recorder's.

    Attributes:
        rate: seconds of the clock per second of the recorder's clock.
        drift: increase of the delay from stamp to arrival over the log [s].
        straight: whether the delay changes linearly, or hardly.
    """

    rate: float
    drift: float
    straight: bool


def pace(topic: Recorded) -> Pace | None:
    """Estimate the rate of a topic's clock from arrival times; None if there are too few messages."""
    known = np.isfinite(topic.time) & np.isfinite(topic.arrival)
    stamps, arrived = topic.time[known], topic.arrival[known]
    if len(stamps) < 2 * _BLOCKS or not arrived.max() > arrived.min():
        return None
    edges = np.linspace(arrived.min(), arrived.max(), _BLOCKS + 1)
    delay, middle = least_delays(arrived, arrived - stamps, edges), (edges[1:] + edges[:-1]) / 2 - edges[0]
    seen = np.isfinite(delay)
    if seen.sum() < _BLOCKS // 2:
        return None
    delay, middle = delay[seen] - delay[seen][0], middle[seen]
    slope, offset = np.polyfit(middle, delay, 1)
    drift = float(slope * (edges[-1] - edges[0]))
    straight = np.abs(delay - slope * middle - offset).max() < _STRAIGHT * abs(drift) or abs(drift) < DRIFT / 2
    return Pace(1 - float(slope), drift, bool(straight))


def _have_arrivals(recorded: Mapping[str, Recorded]) -> bool:
    """Return whether arrival times are known in addition to header stamps."""
    return any(topic.arrived is not None for topic in recorded.values())


def other_origin(recorded: Mapping[str, Recorded], topic: str, pose: str, *, used: bool) -> Finding | None:
    """Report a topic whose clock has another origin than the pose's clock."""
    if not _has_other_origin(recorded[topic], recorded[pose]):
        return None
    own, other = (_origin(float(recorded[name].rising[0])) for name in (topic, pose))
    posed = pace(recorded[pose]) if _have_arrivals(recorded) else None
    real = posed is not None and abs(posed.rate - 1) < _REAL
    runs = "" if posed is None or real else f", whose clock runs at {posed.rate:.4g} times the recorder's rate"
    values = {"pose": pose, "own": own, "other": other, "runs": runs}
    return found("origin", topic, values, (RECEIVE,) if real else (), severity="fatal" if used else "note")


def _has_other_origin(topic: Recorded, pose: Recorded) -> bool:
    both = len(topic.rising) > 0 and len(pose.rising) > 0
    return both and bool(abs(topic.rising[0] - pose.rising[0]) > ORIGINS)


def _origin(start: float) -> str:
    if start > 1e9:
        return f"{start:.3f} s, as of a wall clock ({np.datetime64(int(start), 's')} UTC)"
    return f"{start:.3f} s, as of a simulation or since start-up"


def check_rates(recorded: Mapping[str, Recorded], pose: str, *, used: Collection[str]) -> list[Finding]:
    """Report topics whose clock runs at another rate than the pose's clock, relative to arrival times.

    Args:
        used: topics that a rig reads, if there is one.
    """
    posed = pace(recorded[pose]) if _have_arrivals(recorded) and pose in recorded else None
    if posed is None or not posed.straight:
        return []
    findings = []
    for name, topic in recorded.items():
        own = None if name == pose or _has_other_origin(topic, recorded[pose]) else pace(topic)
        drift = 0.0 if own is None else posed.drift - own.drift
        if own is None or not own.straight or abs(drift) < DRIFT:
            continue
        apart = own.rate / posed.rate - 1
        much = f"{abs(apart):.2%}" if abs(apart) > 1e-3 else f"{1e6 * abs(apart):.0f} ppm"
        side = "faster" if apart > 0 else "slower"
        values = {"pose": pose, "much": much, "side": side, "drift": abs(drift), "own": own.rate, "posed": posed.rate}
        cure: Cure = (RECEIVE,) if abs(posed.rate - 1) < _REAL else ()
        severity: Severity = "fatal" if abs(drift) > DRIFT_LIMIT else "warning"
        finding = found("rate", name, values, cure, severity=severity)
        findings.append(finding if name in used else _unread(finding, score=0.5))
    return findings


def _unread(finding: Finding, *, score: float) -> Finding:
    """Return a finding on a topic that no channel reads."""
    return replace(finding, severity="note", remedy=_UNREAD, score=score, cures=())


def read_by_arrival(log: Log, rig: Rig) -> bool:
    """Return whether clocks differ so much from the pose's clock that controls must be matched by arrival times."""
    pose, recorded = rig.channels["position"].topic, {}
    for name, topic in log.topics.items():
        if topic.fields and not is_bulk(topic) and not topic.part_of:
            with suppress(LogError):  # unreadable topics are reported elsewhere
                recorded[name] = without_values(log, name)
    if pose not in recorded:
        return False
    apart = [other_origin(recorded, name, pose, used=True) for name in recorded if name != pose]
    apart += check_rates(recorded, pose, used=recorded)
    return any(finding is not None and finding.severity == "fatal" and finding.cures for finding in apart)


def check_headers(recorded: Mapping[str, Recorded], *, used: Collection[str]) -> list[Finding]:
    """Report topics whose header clock is apart from the others', by the delays until arrival.

    Args:
        used: topics that a rig reads, if any; findings on others are notes.
    """
    several = {name: r for name, r in recorded.items() if len(r.time) > 2}
    if len(several) < 2 or not _have_arrivals(several):
        return []
    late = {name: float(np.nanmedian(r.arrival - r.time)) for name, r in several.items()}
    usual = float(np.median(list(late.values())))
    apart = {name: delay for name, delay in late.items() if APART < abs(delay - usual) < ORIGINS}
    findings = [found("header_apart", name, {"late": late, "usual": usual}, (RECEIVE,)) for name, late in apart.items()]
    return [f if f.where in used or not used else _unread(f, score=f.score) for f in findings]


def check_steps(recorded: Mapping[str, Recorded], *, used: Collection[str], set_back: SetBack | None) -> list[Finding]:
    """Report a step back of the clocks of all topics at the same time.

    Args:
        used: topics that the rig reads; without a rig (empty) all topics count.
        set_back: step of the recorder's clock, if any; samples are read in the order of that clock.
    """
    topics = [r for name, r in recorded.items() if (name in used or not used) and len(r.rising) > 20]
    cure: Cure = ()
    if set_back is not None:
        step = set_back if any(not _steady(r, set_back) for r in topics) else None
    else:
        step = common_step([topic.time for topic in topics])
        cure = (RECEIVE,) if all(r.arrived is not None for r in topics) else ()
    if step is None:
        return []
    values = {"by": step.by, "at": step.time - beginning(recorded), "stamp": step.time}
    return [found("steps_back", "log", values, cure)]


def _steady(topic: Recorded, set_back: SetBack) -> bool:
    """Return whether header stamps continued when the recorder's clock stepped back: the delay drops by the step."""
    arrived = topic.arrival
    before, after = arrived < set_back.time - set_back.by, arrived > set_back.time
    if not before.any() or not after.any():
        return False
    delay = arrived - topic.time
    return bool(np.median(delay[before]) - np.median(delay[after]) > set_back.by / 2)


class _WheelSpeed(NamedTuple):
    """A field proportional to the speed: speed = scale * value [m/s]."""

    topic: str
    field: str
    scale: float
    correlation: float
    samples: Channel


def check_clocks(recorded: Mapping[str, Recorded], path: DrivenPath, rig: Rig, *, besides: set[str]) -> list[Finding]:
    """Return a finding for each clock of the rig's channels that is late or drifts, one per group of equal stamps.

    Args:
        besides: topics of the pose.
    """
    # If the throttle commands the motor speed, the vehicle's speed follows later: a response, not a clock error.
    controls = [source for name, source in rig.channels.items() if control_of(name) is not None]
    commanded = {(source.topic, field) for source in controls for field in source.fields}
    speed = np.isfinite(path.speed)
    reference = Channel("speed", "m/s", path.time[speed], path.speed[speed, None])
    findings: list[Finding] = []
    checked = besides | (set(rig.alignment.topics) if rig.alignment else set())
    for wheel in sorted(_wheel_speeds(recorded, path, checked), key=lambda w: -w.correlation):
        if wheel.topic in checked or (wheel.topic, wheel.field) in commanded:
            continue
        together = {t for t, r in recorded.items() if np.array_equal(r.time, recorded[wheel.topic].time)}
        checked |= together
        shared = [topic for topic in recorded if topic in together - besides]
        readers = {name: source for name, source in rig.channels.items() if source.topic in shared}
        if not readers:
            continue
        lag = estimate_lag(reference, wheel.samples, max_lag=_MAX_LAG).lag
        low, middle, high = np.percentile(lag, (5, 50, 95))
        if all(map(control_of, readers)) and _LEADS < low <= high < _LATE:
            continue  # a commanded speed, followed by the vehicle's
        field = field_in_words(wheel.topic, wheel.field)
        values = {"field": field, "correlation": wheel.correlation, "low": low, "high": high}
        # Leads caused by wheel slip are harmless if no model reads channels of that clock.
        severity: Severity = "warning" if readers.keys() - {"wheel_speed"} else "note"
        if high - low <= _CHANGE:
            late = [name for name, source in readers.items() if abs(middle - source.delay) > _LATE]
            cure = tuple(Edit(f"channels.{name}.delay", round(float(middle), 2)) for name in late)
            code = "is_late" if middle > 0 else "is_early"
            if not late or abs(middle) <= _LATE:
                continue
        elif _slips(low, high, shares_pose=bool(together & besides)):
            continue
        else:
            speeds = {"topic": wheel.topic, "fields": [wheel.field], "scale": rounded(wheel.scale)}
            cure = (Edit("alignment", {"topics": shared, "speed": speeds, "max_lag": _MAX_LAG}),)
            code = "drifts"
        findings.append(found(code, ", ".join(shared), values, cure, severity=severity))
    return findings


def _slips(low: float, high: float, *, shares_pose: bool) -> bool:
    """Return whether spinning or locked wheels explain the range of a lag [s].

    Args:
        shares_pose: whether it is the pose's clock, which is not ahead of itself, however far wheels run ahead.
    """
    return low < -_LATE or high < _LATE if shares_pose else _SLIP < low <= high < _LATE


def _wheel_speeds(recorded: Mapping[str, Recorded], path: DrivenPath, besides: set[str]) -> Iterator[_WheelSpeed]:
    """Yield fields of other topics that are proportional to the speed, with lags up to two seconds."""
    speed = np.nan_to_num(path.speed)
    fast = speed > min(0.5, 0.5 * path.cruise)
    lagged = path.time + np.arange(-_MAX_LAG / 2, _MAX_LAG / 2 + 0.01, 0.25)[:, None]
    for topic, r in recorded.items() if speed.std() >= 0.1 * speed.mean() else ():
        keep: Bool[np.ndarray, " n"] = np.diff(r.time, prepend=-np.inf) > 0
        keep &= np.isfinite(r.values).all(axis=1) & np.isfinite(r.time)
        if topic in besides or keep.sum() < 200:
            continue
        time = r.time[keep]
        for field, values in zip(r.fields, np.abs(r.values[keep].T), strict=True):
            if np.ptp(values) == 0:
                continue
            tried = np.interp(lagged, time, values)
            with np.errstate(invalid="ignore", divide="ignore"):  # constant during the drive
                correlations = np.nan_to_num(np.corrcoef(speed, tried)[0, 1:])
            best = int(correlations.argmax())
            scale = float(np.median(speed[fast]) / max(np.median(tried[best, fast]), 1e-9))
            # Proportional, not only correlated: a gear or a throttle may rise with the speed, too.
            away = scale * np.interp(path.time, time, values) - speed
            if correlations[best] >= _FOLLOWS and np.mean(away**2) <= 0.09 * np.mean(speed**2):
                samples = Channel("wheel_speed", "m/s", time, scale * values[:, None])
                yield _WheelSpeed(topic, field, scale, float(correlations[best]), samples)
