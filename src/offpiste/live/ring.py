"""Messages between the processes of a drive: rings in shared memory, and values as bytes.

A ring is a file in memory (`/dev/shm`) with a number of slots: one process writes, others read the newest messages, and
none waits. There are no locks, so a writer that is killed in the middle of a message blocks nobody. Each word is stored
at once (aligned, eight bytes). A slot has no number while it is written. A reader accepts a slot if its number matches
before and after the copy and its checksum covers number, length and data, so the order of stores does not matter.
"""

import mmap
import os
import struct
import time
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import google_crc32c
import msgspec
import numpy as np
import torch

from offpiste.core.errors import LiveError
from offpiste.live.robot_messages import Sensors
from offpiste.logs.measurements import Camera, Lidar
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.rig.camera import CameraModel
from offpiste.rig.rig import Rig
from offpiste.runtime.follower import TimedPlan
from offpiste.runtime.prediction import Prediction

_HEAD: Final = struct.Struct("<8sQQ")
"""Magic, number of slots, and bytes per slot: written once by `Ring.create`."""
_MAGIC: Final = b"offring2"
_WRITTEN, _AT, _HEAD_WORDS = 3, 4, 5
"""Words of eight bytes that follow: number of messages, and time of the last one by the monotonic clock [s]."""
_NUMBER, _LENGTH, _CHECKSUM, _SLOT_WORDS = 0, 1, 2, 3
"""Words of a slot before its data: message number, length [bytes], and CRC-32C of both and the data."""
_WORD: Final = 8
_CHECKED: Final = struct.Struct("<QQ")
_TRIES: Final = 8
"""Number of attempts of a reader that the writer overtakes."""
_RESERVED: Final = 16 << 20
"""Maximum size of rings whose memory is reserved at creation [bytes], so that no process which stops the vehicle is
killed when memory runs out."""


class Entry(NamedTuple):
    """Message, and its number since the ring's creation."""

    number: int
    data: bytes


class Ring:
    """Ring in shared memory. A restarted writer continues after the last message."""

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
            raise LiveError("not shared memory of offpiste", where=path, how="remove it")
        self._view = memoryview(self._map)
        self._words, self._times = self._view.cast("Q"), self._view.cast("d")

    @staticmethod
    def create(path: Path, *, slots: int, size: int) -> "Ring":
        """Create a ring of messages of limited size [bytes]; the memory of a large one is allocated when written."""
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
        """Number of messages written."""
        return int(self._words[_WRITTEN])

    @property
    def age(self) -> float:
        """Time since the last message, or since the ring's creation if there is none [s]."""
        return time.monotonic() - float(self._times[_AT])

    def write(self, data: bytes | memoryview) -> bool:
        """Add a message; return False if it is too large."""
        if len(data) > self._size:
            return False
        whole, number = bytes(data), self.written + 1
        word = self._slot(number)
        self._words[word + _NUMBER] = 0  # from here on, readers reject the slot
        begin = (word + _SLOT_WORDS) * _WORD
        self._view[begin : begin + len(whole)] = whole
        self._words[word + _LENGTH] = len(whole)
        self._words[word + _CHECKSUM] = _checksum(number, whole)
        self._words[word + _NUMBER] = number
        self._times[_AT] = time.monotonic()
        self._words[_WRITTEN] = number  # last: a writer that dies earlier has written nothing
        return True

    def newest(self) -> Entry | None:
        """Return the last complete message."""
        for _ in range(_TRIES):
            written = self.written
            for number in range(written, max(written - self._slots + 1, 0), -1):
                if (entry := self._read(number)) is not None:
                    return entry
            if self.written == written:
                return None
        return None

    def since(self, number: int) -> list[Entry]:
        """Return the messages after a number that are still available, oldest first."""
        written = self.written
        found = (self._read(n) for n in range(max(number + 1, written - self._slots + 2), written + 1))
        return [entry for entry in found if entry is not None]

    def close(self) -> None:
        """Release the memory."""
        for view in (self._words, self._times, self._view):
            view.release()
        self._map.close()

    def _slot(self, number: int) -> int:
        """Return the first word of a message's slot."""
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


class Reader:
    """Messages of a ring after a number, by default of the newest one.

    Attributes:
        number: of the last message read.
        lost: number of messages that were overwritten before they were read.
    """

    def __init__(self, ring: Ring, number: int | None = None) -> None:
        self._ring, self.lost = ring, 0
        self.number = ring.written if number is None else number

    def new(self) -> list[dict[str, Any]]:
        """Return the values of all messages since the last call."""
        entries = self._ring.since(self.number)
        if entries:
            self.lost += entries[-1].number - self.number - len(entries)
            self.number = entries[-1].number
        return [unpacked(entry.data) for entry in entries]

    def newest(self) -> dict[str, Any] | None:
        """Return the values of the newest message if it is new."""
        entry = self._ring.newest()
        if entry is None or entry.number == self.number:
            return None
        self.number = entry.number
        return unpacked(entry.data)


def _words_of(size: int) -> int:
    return -(-size // _WORD)


def _bytes(slots: int, size: int) -> int:
    """Return the length of a ring's file."""
    return _WORD * (_HEAD_WORDS + slots * (_SLOT_WORDS + _words_of(size)))


def _checksum(number: int, data: bytes) -> int:
    return int(google_crc32c.extend(google_crc32c.value(_CHECKED.pack(number, len(data))), data))


_ARRAY: Final = "__array__"
Values = Mapping[str, Any]
Record = TypeVar("Record")


def packed(values: Values) -> bytes:
    """Serialise numbers, strings, lists, mappings, dataclasses and arrays."""
    return msgspec.msgpack.encode(values, enc_hook=_plain)


def unpacked(data: bytes) -> dict[str, Any]:
    """Restore the values of `packed`, with writable arrays, and mappings in place of dataclasses."""
    return dict(_with_arrays(msgspec.msgpack.decode(data)))


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        whole = np.ascontiguousarray(value)
        return {_ARRAY: whole.dtype.str, "shape": list(whole.shape), "data": whole.tobytes()}
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(type(value))


def _with_arrays(value: Any) -> Any:
    if isinstance(value, dict):
        if _ARRAY in value:
            return np.frombuffer(bytearray(value["data"]), np.dtype(value[_ARRAY])).reshape(value["shape"])
        return {key: _with_arrays(one) for key, one in value.items()}
    return [_with_arrays(one) for one in value] if isinstance(value, list) else value


def pack_fields(record: Any, **more: Any) -> bytes:
    """Serialise the fields of a dataclass, and further values."""
    return packed({field.name: getattr(record, field.name) for field in fields(record)} | more)


def from_fields(kind: type[Record], values: Values) -> Record:
    """Create a dataclass from its fields, ignoring other values."""
    return kind(**{field.name: values[field.name] for field in fields(kind)})  # type: ignore[arg-type]


def pack_sensors(sensors: Sensors) -> bytes:
    """Serialise calibrations and mountings."""
    cameras, lidars = sensors
    models = {name: {"model": one.model, "mounting": one.body_from_camera} for name, one in cameras.items()}
    return packed({"cameras": models, "lidars": {name: one.body_from_lidar for name, one in lidars.items()}})


def sensors_from(values: Values, rig: Rig) -> Sensors:
    """Rebuild the sensors from stored calibrations and mountings and their entries of the rig."""
    cameras = {}
    for name, given in values["cameras"].items():
        model = CameraModel(**given["model"] | {"distortion": tuple(given["model"]["distortion"])})
        cameras[name] = Camera(name, model, given["mounting"], rig.cameras[name])
    lidars = {name: Lidar(name, mounting, rig.lidars[name]) for name, mounting in values["lidars"].items()}
    return cameras, lidars


def pack_layers(layers: TerrainLayers | None, **more: Any) -> bytes:
    """Serialise the layers of a map, None for an empty one, and further values."""
    return packed({"layers": layers} | more)


def layers_from(values: Values) -> TerrainLayers | None:
    """Restore the layers of a map."""
    return None if values["layers"] is None else TerrainLayers(**values["layers"])


def pack_plan(plan: TimedPlan, **more: Any) -> bytes:
    """Serialise a plan, and further values."""
    return pack_fields(plan, controls=plan.controls.numpy(), **more)


def plan_from(values: Values) -> TimedPlan:
    """Restore a plan."""
    controls, prediction = torch.from_numpy(values["controls"]), Prediction(**values["prediction"])
    return from_fields(TimedPlan, {**values, "controls": controls, "prediction": prediction})
