"""Topics of a log, read once for all checks."""

import re
from collections.abc import Collection, Mapping, Sequence
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
from offpiste.inspection.findings import Finding
from offpiste.logs.channel import increasing
from offpiste.logs.log import Log, Samples, SetBack, Topic
from offpiste.logs.transforms import STAMPED, frame_pair, listed
from offpiste.rig.channels import SECONDS_PER_UNIT, Clock
from offpiste.rig.labels import is_array_entry
from offpiste.rig.rig import Rig

_BULK = re.compile(
    r"(Image|PointCloud2?|LaserScan|OccupancyGrid|GridMap|CameraInfo|TFMessage|tfMessage|Log|ParameterEvent)$"
)
"""Types that are slow to read and hold nothing about the motion."""
_ARRAY = "MultiArray"
"""How types of messages end that are an array (std_msgs)."""
_LARGEST = 1e100
"""Largest number that is taken for a measurement, whatever its unit."""
_MAX_FIELDS = 64
"""Most fields of a topic that are read."""


@dataclass(frozen=True)
class Recorded:
    """One topic's samples as they stand in the file.

    Attributes:
        time: the stamps that the rig asks for [s].
        other: the stamps of the other clock (arrival if `time` is the header's), None where the log has only one [s].
        fields, values: names and one column each.
    """

    topic: Topic
    time: Float[np.ndarray, " n"]
    other: Float[np.ndarray, " n"] | None
    fields: tuple[str, ...]
    values: Float[np.ndarray, "n k"]

    @cached_property
    def rising(self) -> Float[np.ndarray, " m"]:
        """The finite stamps that reading keeps, each later than the one before [s]."""
        return rising(self.time)

    @property
    def copies(self) -> bool:
        """Whether samples with equal stamps hold equal values: another clock would only tear them apart.

        Images and clouds are not compared: they are taken for different ones.
        """
        again = np.flatnonzero(np.diff(self.time) == 0)
        one, other = self.values[again], self.values[again + 1]
        return bool(self.values.shape[1]) and np.array_equal(one, other, equal_nan=True)


class RememberedLog(Log):
    """Another log, each topic of which is decoded once for all checks (a bag would be decoded anew by every read).

    Args:
        rig: all fields that it reads are kept, arrays' entries as well.

    Attributes:
        near: transforms with the names that are nearest to those which the rig reads and the log lacks.
    """

    def __init__(self, log: Log, rig: Rig | None = None) -> None:
        self.path, self.warnings = log.path, log.warnings
        self._log = log
        self._sources = (*rig.channels.values(), *((rig.alignment.speed,) if rig.alignment else ())) if rig else ()
        self._samples: dict[tuple[str, str], Samples] = {}
        self._stamps: dict[tuple[str, str], Float[np.ndarray, " n"]] = {}
        self._opened, self._per_stamp = log.clock, 1.0
        read = {source.topic for source in self._sources}
        self.near = _nearest(read - set(log.topics), [name for name, topic in log.topics.items() if topic.part_of])
        senders = [name for name, topic in log.topics.items() if topic.part_of and topic.type != STAMPED]
        kept = {*listed(log.topics), *read, *self.near, *senders}
        self._topics = {name: topic for name, topic in log.topics.items() if name in kept}

    @property
    def clock(self) -> Clock:
        """The other log's clock."""
        return self._opened

    @property
    def set_back(self) -> SetBack | None:
        """The other log's step back."""
        return self._log.set_back

    def by(self, clock: Clock) -> "RememberedLog":
        """The same samples, their stamps in the unit of another clock where the format has no unit of its own.

        A clock that names neither column nor unit leaves the unit to the log, as on opening it.
        """
        other = copy(self)
        if self._log.has_clock_unit and (clock.column or clock.unit != Clock().unit):
            other._per_stamp = SECONDS_PER_UNIT[clock.unit] / SECONDS_PER_UNIT[self._opened.unit]
        return other

    @property
    def topics(self) -> dict[str, Topic]:
        """The other log's topics, of its many transforms those that are listed, read, or nearly what is read."""
        return self._topics

    def quantities(self, topic: Topic) -> tuple[str, ...]:
        """Fields that are checked: no entries of arrays (scans, covariances) but named ones and what the rig reads.

        Where an array is all that a message is made for, its entries are.
        """
        array = topic.type.endswith(_ARRAY)
        plain = tuple(f for f in topic.fields if array or f in topic.joints or not is_array_entry(f))[:_MAX_FIELDS]
        needed = {field for source in self._sources if source.topic == topic.name for field in source.fields}
        more = tuple(f for f in topic.fields if f in needed and f not in plain)
        return plain + more or topic.fields[:1]

    def stamps(self, topic: str, *, stamps: str = "header") -> Float[np.ndarray, " n"]:
        """The other log's stamps [s]; beyond any that a clock can hold they are infinite."""
        key = (topic, stamps)
        if key not in self._stamps:
            time = self._samples[key].time if key in self._samples else self._log.stamps(topic, stamps=stamps)
            self._stamps[key] = _of_usable_size(Samples(time, np.zeros((len(time), 0)))).time
        return self._stamps[key] * self._per_stamp

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        quantities = self.quantities(topic)
        if not set(fields) <= set(quantities):
            return self._in_unit(_of_usable_size(self._log.read(topic.name, fields, stamps=stamps)))
        key = (topic.name, stamps)
        if key not in self._samples:
            try:
                self._samples[key] = _of_usable_size(self._log.read(topic.name, quantities, stamps=stamps))
            except LogError:
                # One field that cannot be read must not hide the others.
                return self._in_unit(_of_usable_size(self._log.read(topic.name, fields, stamps=stamps)))
        samples = self._samples[key]
        values = samples.values.view()
        values.flags.writeable = False
        if tuple(fields) != tuple(quantities):
            values = values[:, [quantities.index(f) for f in fields]]
        return self._in_unit(Samples(samples.time, values))

    def _in_unit(self, samples: Samples) -> Samples:
        return Samples(samples.time * self._per_stamp, samples.values)


class ReceivedLog(Log):
    """Another log, whose samples are read by their times of arrival, whatever is asked for."""

    def __init__(self, log: Log) -> None:
        self._log = log
        for name in ("path", "warnings", "has_sensors", "has_messages", "messages", "transforms", "images", "clouds"):
            setattr(self, name, getattr(log, name))

    @property
    def topics(self) -> dict[str, Topic]:
        """The other log's topics."""
        return self._log.topics

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        return self._log.read(topic.name, fields, stamps="receive")


def _nearest(lacking: Collection[str], transforms: Sequence[str]) -> set[str]:
    """Transforms whose names are nearest to those that the rig reads and the log lacks, however far they are."""
    wanted = [name for name in lacking if frame_pair(name) is not None]
    return {near for name in wanted for near in get_close_matches(name, transforms, 3, cutoff=0.0)}


def with_fields_of(log: Log, rig: Rig) -> Rig:
    """The rig with its fields by their names in this log (`Topic.fields_here`); those that it lacks are left."""
    channels = dict(rig.channels)
    for name, source in channels.items():
        with suppress(LogError):
            if source.topic in log.topics:
                fields = log.topics[source.topic].fields_here(source.fields, source.joints)
                channels[name] = structs.replace(source, fields=fields)
    return structs.replace(rig, channels=channels)


def rising(time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    """The finite stamps that reading keeps, each later than the one before [s]."""
    time = time[np.isfinite(time)]
    return np.asarray(time[increasing(time)])


def beginning(recorded: Mapping[str, Recorded]) -> float:
    """The first stamp of a log that reading keeps [s]."""
    return min((float(topic.rising[0]) for topic in recorded.values() if len(topic.rising)), default=0.0)


def _of_usable_size(samples: Samples) -> Samples:
    """Samples whose values and stamps beyond `_LARGEST` are infinite: their squares would be."""

    def limited(values: np.ndarray) -> np.ndarray:
        beyond = np.abs(values) > _LARGEST
        return np.where(beyond, np.copysign(np.inf, values), values) if beyond.any() else values

    return Samples(limited(samples.time), limited(samples.values))


def is_bulk(topic: Topic) -> bool:
    """Whether a topic has no samples, or such as are slow to read and hold nothing about the motion."""
    return topic.count == 0 or _BULK.search(topic.type) is not None


def read_topics(
    log: RememberedLog, rig: Rig | None, *, again: bool = False
) -> tuple[dict[str, Recorded], list[Finding]]:
    """Topics with numbers in them, and a finding for each topic or field that cannot be read.

    Args:
        rig: says which stamps count, and whether samples are put in their order; parts of topics are read if it
            does, and those in `log.near`.
        again: whether they were read before, which takes no time that is worth a progress bar.
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
        findings += [Finding("warning", name or "table", e.what, "on reading it", e.how, 1.0) for e in errors]
        if not readable:
            continue
        samples = log.read(name, readable, stamps=stamps)
        other = log.stamps(name, stamps="receive" if stamps == "header" else "header")
        same = np.array_equal(other, samples.time, equal_nan=True)
        order = np.argsort(samples.time, kind="stable") if clock.sort else slice(None)
        arrived = None if same else other[order]
        recorded[name] = Recorded(topic, samples.time[order], arrived, readable, samples.values[order])
    return recorded, findings


def _readable(log: Log, name: str, fields: tuple[str, ...], stamps: str) -> tuple[tuple[str, ...], list[LogError]]:
    try:
        log.read(name, fields, stamps=stamps)
        return fields, []
    except LogError as error:
        if len(fields) == 1:
            return (), [error]
    good: list[str] = []
    errors: dict[str, LogError] = {}
    for field in fields:
        try:
            log.read(name, [field], stamps=stamps)
            good.append(field)
        except LogError as error:
            errors.setdefault(error.what, error)
    return tuple(good), list(errors.values())
