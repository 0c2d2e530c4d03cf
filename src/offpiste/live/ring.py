"""Messages between processes in shared memory: one writes, any number read, nobody waits, the newest win.

A ring is a file in memory (`/dev/shm`) with a number of slots. There are no locks: a writer that is killed or stopped
in the middle of a message holds nobody up, and what it left half written is recognised by its checksum.
"""

import mmap
import struct
import time
from pathlib import Path
from typing import Final, NamedTuple

import google_crc32c

from offpiste.errors import LiveError

_HEAD: Final = struct.Struct("<8sIQQd")
"""Magic, slots, bytes in a slot, messages written, and when the last one was, by the steady clock [s]."""
_SLOT: Final = struct.Struct("<QQI")
"""Number of the message, its length [bytes], and its CRC-32C."""
_MAGIC: Final = b"offring1"


class Entry(NamedTuple):
    """A message, and its number since the ring began."""

    number: int
    data: bytes


class Ring:
    """A ring; `create` makes its file, `open` uses one that is there.

    A writer that is started again continues where the one before it ended.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with path.open("r+b") as file:
                self._map = mmap.mmap(file.fileno(), 0)
        except (OSError, ValueError) as error:
            raise LiveError(f"no shared memory: {error}", where=path, how="start `offpiste live` again") from error
        magic, self._slots, self._size, _, _ = _HEAD.unpack_from(self._map)
        if magic != _MAGIC:
            raise LiveError("is no shared memory of offpiste", where=path, how="remove it")
        self._stride = _SLOT.size + self._size

    @staticmethod
    def create(path: Path, *, slots: int, size: int) -> "Ring":
        """A new ring; memory is taken only where it is written.

        Args:
            slots: number of messages that are kept.
            size: of the largest message [bytes].
        """
        with path.open("xb") as file:
            file.truncate(_HEAD.size + slots * (_SLOT.size + size))
            file.seek(0)
            file.write(_HEAD.pack(_MAGIC, slots, size, 0, time.monotonic()))
        return Ring(path)

    @property
    def written(self) -> int:
        """Number of messages written so far."""
        return int(_HEAD.unpack_from(self._map)[3])

    @property
    def age(self) -> float:
        """Time since the last message was written; since the ring was made, if there is none [s]."""
        return time.monotonic() - float(_HEAD.unpack_from(self._map)[4])

    def write(self, data: bytes | memoryview) -> bool:
        """Add a message; False where it is too large."""
        if len(data) > self._size:
            return False
        number = self.written + 1
        at = _HEAD.size + (number % self._slots) * self._stride
        _SLOT.pack_into(self._map, at, 0, 0, 0)  # a reader that is in the middle of it finds another number
        begin = at + _SLOT.size
        self._map[begin : begin + len(data)] = bytes(data)
        _SLOT.pack_into(self._map, at, number, len(data), google_crc32c.value(bytes(data)))
        _HEAD.pack_into(self._map, 0, _MAGIC, self._slots, self._size, number, time.monotonic())
        return True

    def newest(self) -> Entry | None:
        """The last message that is whole."""
        written = self.written
        for number in range(written, max(written - self._slots + 1, 0), -1):
            if (entry := self._read(number)) is not None:
                return entry
        return None

    def since(self, number: int) -> list[Entry]:
        """Messages after one, as far as they are still there, oldest first."""
        written = self.written
        found = (self._read(n) for n in range(max(number + 1, written - self._slots + 2), written + 1))
        return [entry for entry in found if entry is not None]

    def close(self) -> None:
        """Release the memory."""
        self._map.close()

    def _read(self, number: int) -> Entry | None:
        at = _HEAD.size + (number % self._slots) * self._stride
        held, length, checksum = _SLOT.unpack_from(self._map, at)
        if held != number or length > self._size:
            return None
        begin = at + _SLOT.size
        data = self._map[begin : begin + length]
        if _SLOT.unpack_from(self._map, at)[0] != number or google_crc32c.value(data) != checksum:
            return None
        return Entry(number, data)
