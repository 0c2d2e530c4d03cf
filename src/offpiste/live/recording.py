"""Recording into numbered files that can each be read alone; it ends before the disk is full."""

import shutil
import time
from collections.abc import Collection
from functools import cache
from typing import Any, Final

import numpy as np

from offpiste.core.errors import LogError
from offpiste.live.log_steps import decoded
from offpiste.live.part import free_file
from offpiste.live.session import RecordSettings
from offpiste.logs.ros.writer import McapWriter
from offpiste.logs.transforms import TRANSFORMS, frames
from offpiste.transport.interface import Received
from offpiste.transport.message_types import MessageTypes

_LOOKS: Final = 0.2
"""Time between two looks at the disk and at the size of the file [s]."""
_MOST, _SIZE = 256, 64 << 20
"""Number and size [bytes] of the messages that each file begins with; where there are more, the oldest are left out."""


def refuse_full_disk(settings: RecordSettings) -> None:
    """Check that more disk space is free than has to stay free.

    Raises:
        LogError: it is not.
    """
    if (free := shutil.disk_usage(settings.path.parent).free / 1e9) < settings.free:
        what = f"{free:.3g} GB of the disk are free, and {settings.free:g} GB have to stay free"
        raise LogError(what, where=settings.path, how="make room on the disk, or lower --record-free")


class Recording:
    """Writes messages and begins a new file when one reaches its maximum size or duration.

    Args:
        types: definitions of messages.
        repeated: topics whose newest message is written first in each file; of transforms, one for each set of frames.

    Attributes:
        path: path of the current file.
        messages: number of messages written to all files.

    Raises:
        LogError: a file cannot be written.
    """

    def __init__(self, settings: RecordSettings, types: MessageTypes, repeated: Collection[str]) -> None:
        self._settings, self._types, self._topics = settings, types, frozenset(repeated)
        self._definition = cache(types.definition)
        self._newest: dict[tuple[str, ...], Received] = {}
        self.messages, self._looked = 0, -np.inf
        self._began: int | None = None  # first stamp in the file [ns]
        self._open()

    def add(self, received: Received) -> None:
        """Write a message; messages of repeated topics that arrive before the clock is known are written afterwards."""
        if np.isfinite(received.received):
            stamp = round(received.received * 1e9)
            if self._began is not None and abs(stamp - self._began) > self._settings.seconds * 1e9:
                self._next()
            if self._began is None:
                self._began = stamp
                for one in self._newest.values():
                    self._write(one, stamp)
            self._write(received, stamp)
        if received.topic in self._topics:
            self._keep(received)

    def look(self) -> None:
        """Check disk space and file size at most every `_LOOKS` seconds.

        Raises:
            LogError: less space is free than has to stay free.
        """
        if time.monotonic() - self._looked < _LOOKS:
            return
        self._looked = time.monotonic()
        refuse_full_disk(self._settings)
        if self._began is not None and self.path.stat().st_size > self._settings.size * 1e9:
            self._next()

    def close(self) -> None:
        """Close the current file."""
        self._writer.close()

    def _open(self) -> None:
        self._writer = McapWriter(free_file(self._settings.path))
        self.path = self._writer.path
        self._began = None

    def _next(self) -> None:
        self.close()
        self._open()

    def _write(self, one: Received, stamp: int) -> None:
        self._writer.write_serialised(one.topic, one.type, one.data, self._definition(one.type), stamp)
        self.messages += 1

    def _keep(self, received: Received) -> None:
        of = [received.topic]
        message: Any = decoded(self._types, received.type, received.data) if received.type in TRANSFORMS else None
        if message is not None:
            of += [f"{parent} {child}" for parent, child in map(frames, message.transforms)]
        self._newest.pop(tuple(of), None)  # the order is that of arrival
        self._newest[tuple(of)] = received
        while len(self._newest) > _MOST or sum(len(one.data) for one in self._newest.values()) > _SIZE:
            del self._newest[next(iter(self._newest))]
