"""Checks of clocks against each other: different origins, different rates, a simultaneous step of all."""

from collections.abc import Collection, Mapping
from contextlib import suppress
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import LogError
from offpiste.inspection.findings import Cure, Finding, Severity
from offpiste.inspection.recorded_log import Recorded, beginning, is_bulk
from offpiste.logs.clock_drift import DRIFT_LIMIT, common_step, least_delays
from offpiste.logs.log import Log, SetBack
from offpiste.rig.channels import Clock
from offpiste.rig.edits import Edit
from offpiste.rig.rig import Rig

RECEIVE: Final = Edit("clock.stamps", "receive")
ORIGINS: Final = 86_400.0
"""Minimum distance between clocks with different origins [s]; time zones differ by less."""
_DRIFT: Final = 0.1
"""Minimum drift over the log that is reported [s]."""
_STRAIGHT: Final = 0.2
"""Maximum deviation from a line, as a share of the drift, for a clock of another rate; growing delays deviate more."""
_ONE: Final = "stamp all topics by one clock (of a simulation: use_sim_time in all nodes, and in the recorder)"
_REAL: Final = 0.05
"""Maximum rate difference of a real-time clock from the recorder's clock; simulations run at any rate."""
_REAL_TIME: Final = 1e-3
"""Maximum rate difference at which arrival times are as good as header stamps."""
_BLOCKS: Final = 12
"""Number of time blocks over which the minimum delay is taken."""


class Pace(NamedTuple):
    """Rate of a topic's clock relative to the recorder's.

    Attributes:
        rate: seconds of the clock per second of the recorder's clock.
        drift: increase of the delay from stamp to arrival over the log [s].
        straight: whether the delay changes linearly.
    """

    rate: float
    drift: float
    straight: bool


def arrivals(topic: Recorded) -> Float[np.ndarray, " n"]:
    """Return the arrival times of a topic whose `time` holds header stamps [s]."""
    return topic.time if topic.other is None else topic.other


def pace(topic: Recorded) -> Pace | None:
    """Estimate the rate of a topic's clock from arrival times; None if there are too few messages."""
    known = np.isfinite(topic.time) & np.isfinite(arrivals(topic))
    stamps, arrived = topic.time[known], arrivals(topic)[known]
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
    return Pace(1 - float(slope), drift, bool(np.abs(delay - slope * middle - offset).max() < _STRAIGHT * abs(drift)))


def has_arrivals(recorded: Mapping[str, Recorded], clock: Clock) -> bool:
    """Return whether arrival times are known in addition to header stamps."""
    return clock.stamps == "header" and any(topic.other is not None for topic in recorded.values())


def other_origin(
    recorded: Mapping[str, Recorded], topic: str, pose: str, clock: Clock, *, used: bool
) -> Finding | None:
    """Report a topic whose clock has another origin than the pose's clock."""
    if not _other_origin(recorded[topic], recorded[pose]):
        return None
    own, other = (float(recorded[name].rising[0]) for name in (topic, pose))
    what = f"has another clock than {pose}: they count from different origins"
    evidence = f"it begins at {_origin(own)}, {pose} at {_origin(other)}"
    cures: tuple[Cure, ...] = ()
    if has_arrivals(recorded, clock):
        posed = pace(recorded[pose])
        if posed is not None and abs(posed.rate - 1) < _REAL_TIME:
            cures = ((RECEIVE,),)
        elif posed is not None:
            evidence += f", whose clock runs at {posed.rate:.4g} times the recorder's rate"
    return Finding("fatal" if used else "note", topic, what, evidence, str(RECEIVE) if cures else _ONE, 1.0, cures)


def _other_origin(topic: Recorded, pose: Recorded) -> bool:
    both = len(topic.rising) > 0 and len(pose.rising) > 0
    return both and bool(abs(topic.rising[0] - pose.rising[0]) > ORIGINS)


def _origin(start: float) -> str:
    if start > 1e9:
        return f"{start:.3f} s, as of a wall clock ({np.datetime64(int(start), 's')} UTC)"
    return f"{start:.3f} s, as of a simulation or since start-up"


def check_rates(recorded: Mapping[str, Recorded], pose: str, clock: Clock, *, used: Collection[str]) -> list[Finding]:
    """Report topics whose clock runs at another rate than the pose's clock, relative to arrival times.

    Args:
        used: topics that a rig reads, if there is one.
    """
    if not has_arrivals(recorded, clock) or pose not in recorded or (posed := pace(recorded[pose])) is None:
        return []
    findings, cures = [], ((RECEIVE,),) if abs(posed.rate - 1) < _REAL else ()
    for name, topic in recorded.items():
        own = pace(topic) if name != pose and not _other_origin(topic, recorded[pose]) else None
        drift = 0.0 if own is None else posed.drift - own.drift
        if own is None or abs(drift) < _DRIFT or not (own.straight or abs(own.drift) < _DRIFT / 2):
            continue
        if not (posed.straight or abs(posed.drift) < _DRIFT / 2):
            continue
        apart = own.rate / posed.rate - 1
        much = f"{abs(apart):.2%}" if abs(apart) > 1e-3 else f"{1e6 * abs(apart):.0f} ppm"
        what = f"its clock runs {much} {'faster' if apart > 0 else 'slower'} than that of {pose}"
        evidence = f"{abs(drift):.2f} s over the log, by the times of arrival: in a second of the recorder's clock "
        evidence += f"{own.rate:.6f} s of it and {posed.rate:.6f} s of the pose's"
        severity: Severity = "fatal" if abs(drift) > DRIFT_LIMIT else "warning"
        if name not in used:
            findings.append(Finding("note", name, what, evidence, "none: no channel reads it", 0.5))
        else:
            findings.append(Finding(severity, name, what, evidence, str(RECEIVE) if cures else _ONE, 1.0, cures))
    return findings


def read_by_arrival(log: Log, rig: Rig) -> bool:
    """Return whether clocks differ so much from the pose's clock that controls must be matched by arrival times."""
    pose, clock = rig.channels["position"].topic, rig.clock
    recorded = {}
    for name, topic in log.topics.items():
        if not topic.fields or is_bulk(topic) or topic.part_of:
            continue
        with suppress(LogError):  # unreadable topics are reported elsewhere
            time, arrived = log.stamps(name), log.stamps(name, stamps="receive")
            other = None if np.array_equal(time, arrived, equal_nan=True) else arrived
            recorded[name] = Recorded(topic, time, other, (), np.zeros((len(time), 0)))
    if pose not in recorded:
        return False
    apart = [other_origin(recorded, name, pose, clock, used=True) for name in recorded if name != pose]
    apart += check_rates(recorded, pose, clock, used=recorded)
    return any(finding is not None and finding.severity == "fatal" and finding.cures for finding in apart)


def check_steps(
    recorded: Mapping[str, Recorded], clock: Clock, *, used: Collection[str], set_back: SetBack | None
) -> list[Finding]:
    """Report a step back of the clocks of all topics at the same time.

    Args:
        used: topics that the rig reads; without a rig (empty) all topics count.
        set_back: step of the recorder's clock, if any; samples are read in the order of that clock.
    """
    topics = {name: r for name, r in recorded.items() if (name in used or not used) and len(r.rising) > 20}
    if set_back is not None:
        stepped = {name: r for name, r in topics.items() if r.other is None or not _steady(r, set_back)}
        return _stepped(set_back, recorded, ()) if stepped else []
    if (step := common_step([topic.time for topic in topics.values()])) is None:
        return []
    cures: tuple[Cure, ...] = ((RECEIVE,),) if all(topic.other is not None for topic in topics.values()) else ()
    return _stepped(step, recorded, cures if clock.stamps == "header" else ())


def _steady(topic: Recorded, set_back: SetBack) -> bool:
    """Return whether header stamps continued when the recorder's clock stepped back: the delay drops by the step."""
    arrived = arrivals(topic)
    before, after = arrived < set_back.time - set_back.by, arrived > set_back.time
    if not before.any() or not after.any():
        return False
    delay = arrived - topic.time
    return bool(np.median(delay[before]) - np.median(delay[after]) > set_back.by / 2)


def _stepped(step: SetBack, recorded: Mapping[str, Recorded], cures: tuple[Cure, ...]) -> list[Finding]:
    what = f"all clocks step back by {step.by:.2f} s"
    evidence = (
        f"at {step.time - beginning(recorded):.2f} s, stamp {step.time:.3f} s; the samples around it are in no order"
    )
    how = str(RECEIVE) if cures else "cut the log there, and give both parts: the clock was set while it was recorded"
    return [Finding("fatal", "log", what, evidence, how, 1.0, cures)]
