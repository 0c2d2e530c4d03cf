"""Topics of a log, read once for all checks."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property

import numpy as np
from jaxtyping import Float
from msgspec import structs

from offpiste.core.errors import LogError
from offpiste.core.progress import track
from offpiste.inspection.findings import Finding, unreadable
from offpiste.logs.channel import increasing
from offpiste.logs.log import Log, Samples, SetBack, Topic
from offpiste.logs.transforms import frame_pair, listed
from offpiste.rig.channels import SECONDS_PER_UNIT, ChannelSource, Clock
from offpiste.rig.labels import is_array_entry, is_named
from offpiste.rig.rig import Rig

_ARRAY = "MultiArray"
"""Suffix of message types that are arrays (std_msgs)."""
_LARGEST = 1e100
"""Maximum magnitude of a measurement in any unit."""
_MAX_FIELDS = 64
"""Maximum number of fields read per topic."""


@dataclass(frozen=True)
class Recorded:
    """Samples of one topic as stored in the file.

    Attributes:
        time: stamps selected by the rig [s].
        arrived: arrival times beside header stamps [s]; None if `time` holds them, or the log has only one clock.
        fields, values: field names, and one column per field.
    """

    topic: Topic
    time: Float[np.ndarray, " n"]
    arrived: Float[np.ndarray, " n"] | None
    fields: tuple[str, ...]
    values: Float[np.ndarray, "n k"]

    @cached_property
    def rising(self) -> Float[np.ndarray, " m"]:
        """Finite, strictly increasing stamps that reading keeps [s]."""
        return rising(self.time)

    @property
    def arrival(self) -> Float[np.ndarray, " n"]:
        """Arrival times, as far as the log knows them [s]."""
        return self.time if self.arrived is None else self.arrived

    def has(self, source: ChannelSource) -> bool:
        """Return whether the topic has all fields that a channel reads."""
        return {*source.fields} <= {*self.fields}

    def columns(self, source: ChannelSource) -> Float[np.ndarray, "n c"]:
        """Return the columns that a channel reads."""
        return self.values[:, [self.fields.index(field) for field in source.fields]]

    @property
    def copies(self) -> bool:
        """Return whether samples with equal stamps have equal values, so that another clock would not help.

        Images and point clouds are assumed to differ.
        """
        again = np.flatnonzero(np.diff(self.time) == 0)
        one, other = self.values[again], self.values[again + 1]
        return bool(self.values.shape[1]) and np.array_equal(one, other, equal_nan=True)


class RememberedLog(Log):
    """Log that decodes each topic once for all checks, whereas a bag is decoded on every read.

    Args:
        rig: all fields that it reads are kept, including array entries.

    Attributes:
        near: transforms with names similar to those that the rig reads but the log lacks.
    """

    def __init__(self, log: Log, rig: Rig | None = None) -> None:
        self.path, self.warnings = log.path, log.warnings
        self._log = log
        self._sources = (*rig.channels.values(), *((rig.alignment.speed,) if rig.alignment else ())) if rig else ()
        self._samples: dict[tuple[str, str], Samples] = {}
        self._stamps: dict[tuple[str, str], Float[np.ndarray, " n"]] = {}
        self._per_stamp = 1.0
        topics, read = log.topics, {source.topic for source in self._sources}
        transforms = [name for name, topic in topics.items() if topic.part_of]
        wanted = [name for name in read - set(topics) if frame_pair(name) is not None]
        self.near = {near for name in wanted for near in get_close_matches(name, transforms, 3, cutoff=0.0)}
        kept = {*listed(topics), *read, *self.near}
        self._topics = {name: topic for name, topic in topics.items() if name in kept}

    @property
    def clock(self) -> Clock:
        """Clock of the wrapped log."""
        return self._log.clock

    @property
    def set_back(self) -> SetBack | None:
        """Backward step of the wrapped log's clock."""
        return self._log.set_back

    def by(self, clock: Clock) -> "RememberedLog":
        """Return the same samples with stamps in another clock's unit, if the format has no fixed unit.

        A clock without column and unit leaves the unit to the log, as on opening.
        """
        other = copy(self)
        if self._log.has_clock_unit and (clock.column or clock.unit != Clock().unit):
            other._per_stamp = SECONDS_PER_UNIT[clock.unit] / SECONDS_PER_UNIT[self.clock.unit]
        return other

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics of the wrapped log, with only those transforms that are listed, read or similar to read ones."""
        return self._topics

    def quantities(self, topic: Topic) -> tuple[str, ...]:
        """Return the fields to check, excluding array entries unless they are named or read by the rig.

        All entries are returned for message types that are arrays.
        """
        array = topic.type.endswith(_ARRAY)
        plain = tuple(f for f in topic.fields if array or f in topic.joints or not is_array_entry(f))[:_MAX_FIELDS]
        needed = {field for source in self._sources if source.topic == topic.name for field in source.fields}
        more = tuple(f for f in topic.fields if f in needed and f not in plain)
        return plain + more or topic.fields[:1]

    def stamps(self, topic: str, *, stamps: str = "header") -> Float[np.ndarray, " n"]:
        """Return the stamps of the wrapped log [s]; implausibly large ones are infinite."""
        key = (topic, stamps)
        if key not in self._stamps:
            known = self._samples.get(key)
            self._stamps[key] = _limited(self._log.stamps(topic, stamps=stamps)) if known is None else known.time
        return self._stamps[key] * self._per_stamp

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        key, quantities = (topic.name, stamps), self.quantities(topic)
        samples = self._samples.get(key)
        if not set(fields) <= set(quantities):
            samples, quantities = None, tuple(fields)
        elif samples is None:
            with suppress(LogError):  # one unreadable field must not hide the others
                samples = self._samples[key] = self._decoded(topic.name, quantities, stamps)
        if samples is None:
            samples, quantities = self._decoded(topic.name, fields, stamps), tuple(fields)
        values = samples.values
        if tuple(fields) != quantities:
            values = values[:, [quantities.index(field) for field in fields]]
        return Samples(samples.time * self._per_stamp, values)

    def _decoded(self, topic: str, fields: Sequence[str], stamps: str) -> Samples:
        samples = self._log.read(topic, fields, stamps=stamps)
        values = _limited(samples.values).view()
        values.flags.writeable = False
        return Samples(_limited(samples.time), values)


class ReceivedLog(Log):
    """Log wrapper that always uses arrival times as stamps."""

    def __init__(self, log: Log) -> None:
        self._log = log
        for name in ("path", "warnings", "has_sensors", "has_messages", "messages", "transforms", "images", "clouds"):
            setattr(self, name, getattr(log, name))

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics of the wrapped log."""
        return self._log.topics

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        return self._log.read(topic.name, fields, stamps="receive")


def with_fields_of(log: Log, rig: Rig) -> Rig:
    """Return the rig with field names of this log (`Topic.fields_here`); missing fields are unchanged."""
    channels = dict(rig.channels)
    for name, source in channels.items():
        with suppress(LogError):
            if source.topic in log.topics:
                fields = log.topics[source.topic].fields_here(source.fields, source.joints)
                channels[name] = structs.replace(source, fields=fields)
    return structs.replace(rig, channels=channels)


def rising(time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    """Return the finite, strictly increasing stamps [s]."""
    time = time[np.isfinite(time)]
    return np.asarray(time[increasing(time)])


def beginning(recorded: Mapping[str, Recorded]) -> float:
    """Return the first valid stamp of a log [s]."""
    return min((float(topic.rising[0]) for topic in recorded.values() if len(topic.rising)), default=0.0)


def _limited(values: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Return values with those beyond `_LARGEST` set to infinity, as squares would overflow."""
    beyond = np.abs(values) > _LARGEST
    return np.where(beyond, np.copysign(np.inf, values), values) if beyond.any() else values


def is_bulk(topic: Topic) -> bool:
    """Return whether a topic has no samples, or is slow to read and contains no motion data."""
    return topic.count == 0 or is_named("bulk_types", topic.type)


def read_topics(
    log: RememberedLog, rig: Rig | None, *, again: bool = False
) -> tuple[dict[str, Recorded], list[Finding]]:
    """Return the topics with numeric fields, and a finding for each unreadable topic or field.

    Args:
        rig: selects the stamps, the sorting, and the parts of topics to read besides those in `log.near`.
        again: whether the topics are already decoded, so that no progress bar is needed.
    """
    clock = rig.clock if rig else Clock()
    stamps, used = clock.stamps, {source.topic for source in rig.channels.values()} if rig else set()
    recorded: dict[str, Recorded] = {}
    findings: list[Finding] = []
    topics = log.topics.items()
    for name, topic in topics if again else track(topics, "topics", total=len(topics)):
        fields = log.quantities(topic)
        if not fields or is_bulk(topic) or (topic.part_of and name not in used | log.near):
            continue
        readable, errors = _readable(log, name, fields, stamps)
        findings += [unreadable(name or "table", error, severity="warning") for error in errors]
        if not readable:
            continue
        samples = log.read(name, readable, stamps=stamps)
        arrived = _arrived(log, name, samples.time, stamps)
        order = np.argsort(samples.time, kind="stable") if clock.sort else slice(None)
        arrived = None if arrived is None else arrived[order]
        recorded[name] = Recorded(topic, samples.time[order], arrived, readable, samples.values[order])
    return recorded, findings


def without_values(log: Log, name: str, *, stamps: str = "header", delay: float = 0.0) -> Recorded:
    """Return a topic without its values.

    Args:
        stamps: "header" or "receive".
        delay: subtracted from the stamps [s].
    """
    time = log.stamps(name, stamps=stamps)
    arrived = _arrived(log, name, time, stamps)
    return Recorded(log.topics[name], time - delay, arrived, (), np.zeros((len(time), 0)))


def _arrived(log: Log, name: str, time: Float[np.ndarray, " n"], stamps: str) -> Float[np.ndarray, " n"] | None:
    """Return the arrival times of a topic [s]; None if its stamps are arrival times."""
    arrived = time if stamps == "receive" else log.stamps(name, stamps="receive")
    return None if np.array_equal(time, arrived, equal_nan=True) else arrived


def _readable(log: Log, name: str, fields: tuple[str, ...], stamps: str) -> tuple[tuple[str, ...], list[LogError]]:
    good: list[str] = []
    errors: dict[str, LogError] = {}
    for field in fields:
        try:
            log.read(name, [field], stamps=stamps)
            good.append(field)
        except LogError as error:
            errors.setdefault(error.what, error)
    return tuple(good), list(errors.values())
