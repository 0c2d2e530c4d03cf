"""Messages between processes in shared memory: one writes, any number read, nobody waits, the newest win.

A ring is a file in memory (`/dev/shm`) with a number of slots. There are no locks: a writer that is killed or stopped
in the middle of a message holds nobody up. Every word that changes is stored at once (aligned, eight bytes), so that no
reader sees half a number, and no number is ever lost. A slot has no number while it is written; a reader takes what it
holds if the number is the one it looks for before and after, and the checksum is that of number, length and data:
the order in which the processor makes stores visible does not matter.
"""

import mmap
import os
import struct
import time
from pathlib import Path
from typing import Final, NamedTuple

import google_crc32c

from offpiste.core.errors import LiveError

_HEAD: Final = struct.Struct("<8sQQ")
"""Magic, slots, and bytes in a slot: written once, when the ring is made."""
_MAGIC: Final = b"offring2"
_WRITTEN, _AT, _HEAD_WORDS = 3, 4, 5
"""Words of eight bytes after these: messages written, and when the last one was, by the steady clock [s]."""
_NUMBER, _LENGTH, _CHECKSUM, _SLOT_WORDS = 0, 1, 2, 3
"""Words of a slot before its data: number of the message, its length [bytes], and CRC-32C of both and the data."""
_WORD: Final = 8
_CHECKED: Final = struct.Struct("<QQ")
_TRIES: Final = 8
"""How often a reader that the writer has lapped looks again."""
_RESERVED: Final = 16 << 20
"""Rings that are not larger have their memory from the beginning [bytes]: where it runs out, no process that stops the
vehicle is killed for want of a page."""


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
        magic, self._slots, self._size = _HEAD.unpack_from(self._map) if len(self._map) >= _HEAD.size else (b"", 0, 0)
        if magic != _MAGIC or len(self._map) != _bytes(self._slots, self._size):
            self._map.close()
            raise LiveError("is no shared memory of offpiste", where=path, how="remove it")
        self._view = memoryview(self._map)
        self._words, self._times = self._view.cast("Q"), self._view.cast("d")

    @staticmethod
    def create(path: Path, *, slots: int, size: int) -> "Ring":
        """A new ring; memory of large ones is taken only where it is written.

        Args:
            slots: number of messages that are kept.
            size: of the largest message [bytes].

        Raises:
            LiveError: there is no memory for it.
        """
        length = _bytes(slots, size)
        try:
            with path.open("xb") as file:
                file.truncate(length)
                if length <= _RESERVED:
                    os.posix_fallocate(file.fileno(), 0, length)
                file.write(_HEAD.pack(_MAGIC, slots, size) + struct.pack("=Qd", 0, time.monotonic()))
        except OSError as error:
            raise LiveError(f"no shared memory: {error.strerror}", where=path, how="make room there") from error
        return Ring(path)

    @property
    def written(self) -> int:
        """Number of messages written so far."""
        return int(self._words[_WRITTEN])

    @property
    def age(self) -> float:
        """Time since the last message was written; since the ring was made, if there is none [s]."""
        return time.monotonic() - float(self._times[_AT])

    def write(self, data: bytes | memoryview) -> bool:
        """Add a message; False where it is too large."""
        if len(data) > self._size:
            return False
        whole, number = bytes(data), self.written + 1
        word = self._slot(number)
        self._words[word + _NUMBER] = 0  # from here on, nobody takes what is in the slot
        begin = (word + _SLOT_WORDS) * _WORD
        self._view[begin : begin + len(whole)] = whole
        self._words[word + _LENGTH] = len(whole)
        self._words[word + _CHECKSUM] = _checksum(number, whole)
        self._words[word + _NUMBER] = number
        self._times[_AT] = time.monotonic()
        self._words[_WRITTEN] = number  # last: a writer that dies before has written nothing
        return True

    def newest(self) -> Entry | None:
        """The last message that is whole."""
        for _ in range(_TRIES):
            written = self.written
            for number in range(written, max(written - self._slots + 1, 0), -1):
                if (entry := self._read(number)) is not None:
                    return entry
            if self.written == written:
                return None
        return None

    def since(self, number: int) -> list[Entry]:
        """Messages after one, as far as they are still there, oldest first."""
        written = self.written
        found = (self._read(n) for n in range(max(number + 1, written - self._slots + 2), written + 1))
        return [entry for entry in found if entry is not None]

    def close(self) -> None:
        """Release the memory."""
        for view in (self._words, self._times, self._view):
            view.release()
        self._map.close()

    def _slot(self, number: int) -> int:
        """First word of a message's slot."""
        return _HEAD_WORDS + (number % self._slots) * (_SLOT_WORDS + _words_of(self._size))

    def _read(self, number: int) -> Entry | None:
        word = self._slot(number)
        held, length, checksum = self._words[word : word + _SLOT_WORDS]
        if held != number or length > self._size:
            return None
        begin = (word + _SLOT_WORDS) * _WORD
        data = bytes(self._view[begin : begin + length])
        if self._words[word + _NUMBER] != number or _checksum(number, data) != checksum:
            return None
        return Entry(number, data)


def _words_of(size: int) -> int:
    return -(-size // _WORD)


def _bytes(slots: int, size: int) -> int:
    """Length of a ring's file."""
    return _WORD * (_HEAD_WORDS + slots * (_SLOT_WORDS + _words_of(size)))


def _checksum(number: int, data: bytes) -> int:
    return int(google_crc32c.extend(google_crc32c.value(_CHECKED.pack(number, len(data))), data))
