"""The result of an inspection: what was driven, the topics, the findings."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from offpiste.inspection.driven_path import MOVING, Path
from offpiste.inspection.findings import Finding, is_fatal, ranked
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.stamps import timing
from offpiste.logs.log import Log
from offpiste.rig.clock import Clock


@dataclass(frozen=True)
class TopicRow:
    """A topic's row in the table: rate [Hz] and length [s] are None where they are not known."""

    name: str
    type: str
    count: int
    rate: float | None
    seconds: float | None


@dataclass(frozen=True)
class Summary:
    """What was driven, by the pose; fields are None where no pose was found.

    Attributes:
        duration: length of the log [s].
        distance: length of the driven path [m].
        speed_median, speed_p95, speed_max: [m/s].
        standing: share of the time at a standstill.
    """

    duration: float
    distance: float | None = None
    speed_median: float | None = None
    speed_p95: float | None = None
    speed_max: float | None = None
    standing: float | None = None


@dataclass(frozen=True)
class Inspection:
    """All that is known of a log before training on it.

    Attributes:
        rig: name of the rig that it was read through; "" if channels were guessed.
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
        return not is_fatal(self.findings)

    def with_findings(self, more: Iterable[Finding]) -> "Inspection":
        """The same inspection with further findings, ranked anew."""
        return replace(self, findings=ranked((*self.findings, *more)))

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, texts and lists, for JSON."""
        return {"schema": 1, "usable": self.usable, **asdict(self)}


def summarise(recorded: dict[str, Recorded], path: Path | None) -> Summary:
    """Length of the log, and of the driven path its length and speeds."""
    stamps = [r.time[np.isfinite(r.time)] for r in recorded.values()]
    stamps = [s for s in stamps if len(s)]
    duration = float(max(s.max() for s in stamps) - min(s.min() for s in stamps)) if stamps else 0.0
    if path is None or not np.isfinite(path.speed).any():
        return Summary(duration)
    speed = path.speed[np.isfinite(path.speed)]
    middle, fast, top = np.percentile(speed, (50, 95, 100))
    return Summary(duration, path.distance, float(middle), float(fast), float(top), float(np.mean(speed < MOVING)))


def topic_rows(log: Log, recorded: dict[str, Recorded], clock: Clock) -> tuple[TopicRow, ...]:
    """A row for every topic of a log."""
    rows = []
    for name, topic in log.topics.items():
        seen = timing(recorded[name].time, max_gap=clock.max_gap) if name in recorded else None
        rate = seen.rate if seen and np.isfinite(seen.rate) else None
        seconds = seen.end - seen.start if seen and np.isfinite(seen.start) else None
        rows.append(TopicRow(name or "table", topic.type, topic.count, rate, seconds))
    return tuple(rows)
