"""A recording in memory: topics as a file would hold them, and the rig through which they are read."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float

from offpiste.logs.channel import convert
from offpiste.logs.log import Log, Samples, Topic
from offpiste.rig.channels import SECONDS_PER_UNIT, ChannelSource, Clock, unit_factor
from offpiste.rig.edits import Edit, edited, toml_value
from offpiste.rig.rig import Rig


@dataclass(frozen=True)
class Stream:
    """Samples of one topic, in the order of the file.

    Attributes:
        time: stamps [s].
        arrival: when each message arrived [s]; None where the format does not keep it.
        columns: one column a field.
    """

    time: Float[np.ndarray, " n"]
    arrival: Float[np.ndarray, " n"] | None
    columns: dict[str, Float[np.ndarray, " n"]]

    def rows(self, keep: np.ndarray) -> "Stream":
        """Some samples, by a mask or by their numbers, which may repeat and be in any order."""
        arrival = None if self.arrival is None else self.arrival[keep]
        return Stream(self.time[keep], arrival, {name: column[keep] for name, column in self.columns.items()})


class RecordingLog(Log):
    """A log of streams in memory."""

    description = "a recording in memory"
    has_clock_unit = True

    def __init__(self, streams: dict[str, Stream], clock: Clock) -> None:
        self.path, self._streams, self._clock = Path("recording"), streams, clock

    @property
    def topics(self) -> dict[str, Topic]:
        """One topic a stream."""
        return {name: Topic(name, "memory", len(s.time), tuple(s.columns)) for name, s in self._streams.items()}

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        stream = self._streams[topic.name]
        if stamps == "receive" and stream.arrival is not None:
            time = stream.arrival
        else:
            time = stream.time * SECONDS_PER_UNIT[self._clock.unit]
        return Samples(time, np.column_stack([stream.columns[field] for field in fields]))

    @property
    def clock(self) -> Clock:
        """The unit of the stamps, by the rig."""
        return Clock(unit=self._clock.unit)


@dataclass(frozen=True)
class Case:
    """A recording and the rig that it is read through; illnesses change one, the other, or both.

    Attributes:
        streams: by topic.
    """

    streams: dict[str, Stream]
    rig: Rig

    @property
    def log(self) -> Log:
        """The recording as a log."""
        return RecordingLog(self.streams, self.rig.clock)

    def has(self, *channels: str) -> bool:
        """Whether the rig gives all of these channels."""
        return set(channels) <= set(self.rig.channels)

    def source(self, channel: str) -> ChannelSource:
        """Where the rig reads a channel."""
        return self.rig.channels[channel]

    def stream(self, channel: str) -> Stream:
        """The topic that a channel is read from."""
        return self.streams[self.source(channel).topic]

    def raw(self, channel: str) -> Float[np.ndarray, "n k"]:
        """A channel's numbers as recorded."""
        stream = self.stream(channel)
        return np.column_stack([stream.columns[field] for field in self.source(channel).fields])

    def values(self, channel: str) -> Float[np.ndarray, "n k"]:
        """A channel as the rig converts it."""
        return convert(channel, self.source(channel), self.raw(channel), self.rig.vehicle)

    def with_raw(self, channel: str, raw: Float[np.ndarray, "n k"]) -> "Case":
        """The case with other recorded numbers in a channel's fields."""
        source, stream = self.source(channel), self.stream(channel)
        columns = stream.columns | dict(zip(source.fields, raw.T.copy(), strict=True))
        return self.with_stream(source.topic, replace(stream, columns=columns))

    def with_values(self, channel: str, values: Float[np.ndarray, "n k"]) -> "Case":
        """The case with numbers recorded that the rig converts to these values."""
        source = self.source(channel)
        raw = (source.sign * values / unit_factor(channel, source.unit) - source.offset) / source.scale
        return self.with_raw(channel, raw)

    def scaled(self, channel: str, factor: float) -> "Case":
        """The case with a channel whose values are `factor` times as large."""
        return self.with_values(channel, factor * self.values(channel))

    def with_stream(self, topic: str, stream: Stream) -> "Case":
        """The case with another stream for a topic."""
        return replace(self, streams={**self.streams, topic: stream})

    def with_rows(self, topic: str, choose: Callable[[int], np.ndarray]) -> "Case":
        """The case with some rows of a topic; `choose` takes their number and gives a mask or row numbers."""
        stream = self.streams[topic]
        return self.with_stream(topic, stream.rows(choose(len(stream.time))))

    def with_stamps(self, topic: str, change: Callable[[np.ndarray], np.ndarray]) -> "Case":
        """The case with other stamps of a topic; times of arrival stay."""
        stream = self.streams[topic]
        return self.with_stream(topic, replace(stream, time=change(stream.time.copy())))

    def with_rig(self, *entries: tuple[str, object]) -> "Case":
        """The case with some entries of the rig set."""
        return replace(self, rig=edited(self.rig, [Edit(key, value) for key, value in entries]))

    def readers(self, topic: str) -> tuple[str, ...]:
        """Channels that the rig reads from a topic."""
        return tuple(name for name, source in self.rig.channels.items() if source.topic == topic)


def rig_text(rig: Rig) -> str:
    """A rig as TOML, to read it again with `parse_rig`."""
    entries = {key: value for key, value in msgspec.to_builtins(rig).items() if value not in (None, {}, "")}
    top = [f"{key} = {toml_value(value)}" for key, value in entries.items() if not isinstance(value, dict)]
    return "\n".join(top + _tables(entries, "")) + "\n"


def _tables(entries: dict[str, object], path: str) -> list[str]:
    lines: list[str] = []
    for key, value in entries.items():
        if not isinstance(value, dict):
            continue
        name = f"{path}{key}"
        if all(isinstance(entry, dict) for entry in value.values()):
            lines += _tables(value, f"{name}.")
            continue
        lines.append(f"\n[{name}]")
        lines += [f"{entry} = {toml_value(v)}" for entry, v in value.items() if v is not None]
    return lines
