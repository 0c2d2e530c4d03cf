"""What a recorded log is to the rest: topics with numeric fields, each sample with its stamp."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from offpiste.errors import LogError


@dataclass(frozen=True)
class Topic:
    """What a log holds under one name, known before its samples are read.

    Attributes:
        type: message type, or the kind of file.
        count: number of samples.
        fields: names of the numeric fields; empty where they are known only from a message, and there is none.
    """

    name: str
    type: str
    count: int
    fields: tuple[str, ...]


@dataclass(frozen=True)
class Samples:
    """Numbers as recorded, in the order of the file; nothing is sorted, dropped or converted yet.

    Attributes:
        time: stamps [s].
        values: one column a field.
    """

    time: Float[np.ndarray, " n"]
    values: Float[np.ndarray, "n k"]


class Log(ABC):
    """A recorded drive in any format. Readers are final; `offpiste.logs.open_log` chooses one.

    Attributes:
        warnings: what a damaged or ambiguous log made the reader leave out or guess, in words.
    """

    path: Path
    warnings: tuple[str, ...] = ()

    @property
    @abstractmethod
    def topics(self) -> dict[str, Topic]:
        """Topics by name."""

    @abstractmethod
    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples: ...

    def read(self, topic: str, fields: Sequence[str], *, stamps: str = "header") -> Samples:
        """Samples of some fields of a topic.

        Args:
            topic: name in `topics`.
            fields: names in the topic's `fields`.
            stamps: "header" (a message's own stamp where it has one) or "receive"; readers without the two ignore it.

        Raises:
            LogError: no such topic or field, no sample in it, or the file is damaged there.
        """
        found = self._found(topic)
        if found.count == 0:
            raise LogError(f"topic '{topic}' is empty", where=self.path, how="declare its channels absent in the rig")
        missing = [f for f in fields if f not in found.fields]
        if missing:
            raise LogError(
                f"topic '{topic}' ({found.type}) has no field '{missing[0]}'",
                where=self.path,
                how=f"it has: {', '.join(found.fields[:40]) or 'no numeric field'}",
            )
        return self._read(found, fields, stamps)

    def _found(self, topic: str) -> Topic:
        found = self.topics.get(topic)
        if found is None:
            known = ", ".join(sorted(self.topics)) or "none"
            raise LogError(f"no topic '{topic}'", where=self.path, how=f"it has: {known}")
        return found
