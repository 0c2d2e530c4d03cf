"""ROS 1 and ROS 2 bags, without ROS: numbers, images, point clouds, calibrations and transforms."""

import weakref
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import LogError, SeveralLogs
from offpiste.logs.clock_drift import common_step
from offpiste.logs.log import LOG_FORMATS, Log, RawCloud, RawImage, Samples, SetBack, Times, Topic, contents_of
from offpiste.logs.ros.bag_files import (
    MAGIC,
    MakeDecoder,
    Reader,
    field_getter,
    fields_of,
    open_readers,
    reported,
    stamp_of,
    stamp_reader,
    storage_files,
    typestore_of,
    whole_messages,
)
from offpiste.logs.ros.bounds import Rosbag1
from offpiste.logs.ros.image_encodings import pixels_of
from offpiste.logs.ros.mcap_columns import Columns, columns_of
from offpiste.logs.ros.mcap_recovery import StreamedMcap
from offpiste.logs.ros.sensor_messages import Joints, frame_of, has_joints, points_from_message
from offpiste.logs.transforms import (
    STAMPED,
    STAMPED_FIELDS,
    TRANSFORMS,
    FramePair,
    Transform,
    frame_pair,
    frame_pairs,
    transform_of,
)
from offpiste.rig.camera import CameraModel, model_from_message

_IMAGE_TYPES: Final = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")
_CLOUD_TYPES: Final = ("sensor_msgs/msg/PointCloud2",)
_CALIBRATIONS: Final = ("sensor_msgs/msg/CameraInfo",)
_OVERLAP: Final = 10**9
"""Largest overlap between pieces of a recording [ns]."""
_JOINTS: Final = "sensor_msgs/msg/JointState"
_TURNS: Final = 4
"""Number of first messages of a sensor whose frames are compared to detect several senders."""
_FIRST: Final = 100
"""Number of messages of a topic that give the names of its joints, or the lengths of its sequences."""


@LOG_FORMATS.register("bag")
class BagLog(Log):
    """ROS 1 `.bag`, ROS 2 `.mcap` or `.db3`, or the folder of one; message definitions come from the bag.

    Fields are dotted paths to numbers and booleans, e.g. `pose.pose.position.x` or `pose.covariance[0]`: entries of
    fixed-size arrays of at most 36, and of sequences the first 36 entries of the first message with any (NaN in shorter
    later ones). Entries of sensor_msgs/JointState are identified by the names in the first hundred messages. Each pair
    of frames in the first messages of tf2_msgs/TFMessage is a topic of its own (`offpiste.logs.transforms`). Headers,
    text, raw bytes and sequences of messages are not fields. Samples are in order of arrival. A truncated MCAP file is
    read up to its last complete chunk.
    """

    description = "a ROS bag (.bag, .mcap, .db3, or the folder of one)"
    has_sensors = has_messages = has_arrivals = True

    def __init__(self, path: Path) -> None:
        self.path = path
        self._kept: dict[int, dict[int, Columns]] = {}
        self._joints: dict[str, Joints] = {}
        notes: list[str] = []
        with ExitStack() as stack:
            self._readers = open_readers(path, notes)
            for reader in self._readers:
                stack.callback(reader.close)
            _refuse_several(self._readers, path)
            notes += [f"not read: {name}, which is not part of this bag" for name in _others(self._readers, path)]
            names = {connection.topic for reader in self._readers for connection in reader.connections}
            self._topics = {name: self._describe(name, notes) for name in sorted(names)}
            self._topics |= {pair.name: pair for pair in self._transforms_as_topics() if pair.name not in names}
            weakref.finalize(self, stack.pop_all().close)
        self.warnings = tuple(notes)

    @staticmethod
    def recognises(path: Path) -> bool:
        """Return whether a file has the extension of a bag, or a folder holds one."""
        if path.is_dir():
            return (path / "metadata.yaml").is_file() or bool(storage_files(path))
        return path.suffix in MAGIC

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics by name; a topic that cannot be decoded has no fields, and the reason as its type."""
        return self._topics

    @property
    def set_back(self) -> SetBack | None:
        """Backward step of the recorder's clock, from the file order of messages in .bag and .mcap files."""
        for k, reader in enumerate(self._readers):
            filed = [one.filed for one in self._columns_of(k).values()]
            if isinstance(reader, Rosbag1):
                places = [sorted((one.chunk_pos, one.offset, one.time) for one in i) for i in reader.indexes.values()]
                filed = [np.array([time for *_, time in index], np.int64) for index in places]
            if (step := common_step([one / 1e9 for one in filed])) is not None:
                return step
        return None

    def messages(self, topic: str, *, stamps: str = "header") -> Iterator[tuple[float, Any]]:
        """Yield the stamp [s] and the decoded message of each message, in file order."""
        result = self._find(topic)
        for received, message in self._messages(result.name, result.type):
            yield stamp_of(received, message, stamps), message

    def stamps(self, topic: str, *, stamps: str = "header") -> Float[np.ndarray, " n"]:
        """Return the stamps of all messages of a topic in file order [s]; only headers are decoded."""
        result = self._find(topic)
        columns = self._columns(result)
        if columns is not None:
            return np.concatenate([one.seconds(stamps) for one in columns])
        heads = self._messages(result.name, result.type, stamp_reader)
        return np.array([stamp_of(received, head, stamps) for received, head in heads])

    def _describe(self, name: str, notes: list[str]) -> Topic:
        connections = [c for reader in self._readers for c in reader.connections if c.topic == name]
        main = max(connections, key=lambda c: c.msgcount)
        count = sum(c.msgcount for c in connections if c.msgtype == main.msgtype)
        if others := {c.msgtype for c in connections} - {main.msgtype}:
            notes.append(f"{self.path}: topic '{name}' also carries {', '.join(sorted(others))}, which are not read")

        decoded, kept = islice(self._messages(name, main.msgtype), _FIRST), list[object]()

        def first() -> Iterator[object]:
            yield from kept
            try:
                for _, message in decoded:
                    kept.append(message)
                    yield message
            except LogError as error:
                notes.append(str(error))

        try:
            store = typestore_of(main, self.path)
            if main.msgtype == _JOINTS and has_joints(store.get_msgdef(_JOINTS).fields):
                joints = self._joints[name] = Joints(first())
                return Topic(name, main.msgtype, count, joints.fields, joints=joints.names)
            return Topic(name, main.msgtype, count, tuple(fields_of(store, main.msgtype, first)))
        except LogError as error:
            notes.append(f"topic '{name}': {error}")
            return Topic(name, error.what, count, ())

    def _transforms_as_topics(self) -> list[Topic]:
        """Return a topic for each pair of frames, possible poses of the vehicle first."""
        result: list[Topic] = []
        for topic in self._topics.values():
            if topic.type in TRANSFORMS and not topic.name.endswith("static"):
                first, counts = (message for _, message in self._messages(topic.name, topic.type)), Counter[FramePair]()
                with suppress(LogError):  # damage is reported on reading
                    for one in frame_pairs(topic.name, first):
                        counts[one] += 1
                for one in sorted(counts, key=lambda one: not one.is_of_a_body):
                    result.append(Topic(one.name, STAMPED, counts[one], STAMPED_FIELDS, part_of=topic.name))
        return result

    def _messages(self, name: str, msgtype: str, decoder: MakeDecoder = whole_messages) -> Iterator[tuple[int, Any]]:
        """Yield the arrival [ns] and the decoded message."""
        recorded = any(c.topic == name for reader in self._readers for c in reader.connections)
        if not recorded and (one := frame_pair(name)) is not None:
            for received, message in self._messages(one.topic, self._topics[one.topic].type):
                yield from ((received, stamped) for stamped in one.of(message))
            return
        for reader in self._readers:
            connections = [c for c in reader.connections if c.topic == name and c.msgtype == msgtype]
            if not connections:
                continue
            decoders = {c.id: decoder(c, self.path) for c in connections}
            with reported(Path(str(reader.path)), f"topic '{name}' is damaged"):
                for connection, received, raw in reader.messages(connections):
                    yield received, decoders[connection.id](raw)

    def _columns(self, topic: Topic) -> list[Columns] | None:
        """Return the columns of a topic, one per file; None if each message must be decoded.

        One pass reads and keeps those of all topics: some 10 MB for an hour of ten numbers at 50 Hz.
        """
        result: list[Columns] = []
        for k, reader in enumerate(self._readers):
            wanted = [c for c in reader.connections if c.topic == topic.name and c.msgtype == topic.type]
            if sum(c.msgcount for c in wanted):
                if len(wanted) > 1 or wanted[0].id not in self._columns_of(k):
                    return None
                result.append(self._columns_of(k)[wanted[0].id])
        return result or None

    def _columns_of(self, file: int) -> dict[int, Columns]:
        if file not in self._kept:
            self._kept[file] = columns_of(self._readers[file], self.path)
        return self._kept[file]

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        columns, joints = self._columns(topic), self._joints.get(topic.name)
        if joints is not None and len(self._readers) > 1:
            columns = None  # names are constant within single files only
        if columns is not None and all(set(fields) <= set(one.fields) for one in columns):
            parts = [one.values[:, [one.fields.index(f) for f in fields]] for one in columns]
            return Samples(np.concatenate([one.seconds(stamps) for one in columns]), np.concatenate(parts))
        getters = [field_getter(field) for field in fields]
        read = joints.reader(fields) if joints is not None else lambda message: [get(message) for get in getters]
        time, rows = [], []
        for received, message in self._messages(topic.name, topic.type):
            time.append(stamp_of(received, message, stamps))
            rows.append(read(message))
        if len(time) < topic.count:
            what = f"topic '{topic.name}' has {len(time)} messages where the index promises {topic.count}"
            raise LogError(what, where=self.path, how="the bag was cut short or mixed; record or copy it again")
        return Samples(np.array(time), np.array(rows, dtype=np.float64).reshape(len(time), len(fields)))

    def transforms(self, topics: Sequence[str]) -> list[Transform]:
        """Return the first transform of each pair of frames in topics of tf2_msgs/TFMessage."""
        result: dict[tuple[str, str], Transform] = {}
        for topic in topics:
            if topic in self.topics:
                for _, message in self._typed(topic, TRANSFORMS):
                    for transform in map(transform_of, message.transforms):
                        result.setdefault((transform.parent, transform.child), transform)
        return list(result.values())

    def camera_model(self, topic: str, *, rectified: bool) -> tuple[CameraModel, Float[np.ndarray, "4 4"]]:
        """Return the calibration in the topic's first CameraInfo."""
        first = next(self._typed(topic, _CALIBRATIONS), None)
        if first is None:
            how = "give the camera's intrinsics in the rig"
            raise LogError(f"topic '{topic}' is empty: images without calibration", where=self.path, how=how)
        return model_from_message(first[1], topic, rectified=rectified)

    def frame(self, topic: str) -> str:
        """Return the frame in the headers of the first messages; raise `LogError` if they differ."""
        frames = list(dict.fromkeys(frame_of(message) for _, message in islice(self.messages(topic), _TURNS)))
        if not frames:
            raise LogError(f"topic '{topic}' is empty", where=self.path, how="remove the sensor from the rig")
        if len(frames) > 1:
            what = f"topic '{topic}' has several senders, of frames {', '.join(map(repr, frames))}"
            raise LogError(what, where=self.path, how="give each a topic of its own, and record it again")
        return frames[0]

    def images(self, topic: str, *, stamps: str = "header", times: Times | None = None) -> Iterator[RawImage]:
        """Yield images of sensor_msgs/CompressedImage and Image; some `times` by the file's index."""
        for time, message in self._typed(topic, _IMAGE_TYPES, stamps, times):
            yield RawImage(time, frame_of(message), pixels_of(message, topic))

    def clouds(self, topic: str, *, stamps: str = "header", times: Times | None = None) -> Iterator[RawCloud]:
        """Yield point clouds of sensor_msgs/PointCloud2; some `times` by the file's index."""
        for time, message in self._typed(topic, _CLOUD_TYPES, stamps, times):
            yield RawCloud(time, frame_of(message), points_from_message(message))

    def _at(self, topic: Topic, times: Times, stamps: str) -> Iterator[tuple[float, Any]]:
        """Yield the messages with given stamps, found by their arrival in an indexed file."""
        columns = self._columns(topic)
        if columns is None:
            yield from (one for one in self.messages(topic.name, stamps=stamps) if one[0] in times)
            return
        readers = [r for r in self._readers if any(c.topic == topic.name and c.msgcount for c in r.connections)]
        for reader, one in zip(readers, columns, strict=True):
            assert not isinstance(reader, StreamedMcap), "has no index"
            connections = [c for c in reader.connections if c.topic == topic.name and c.msgtype == topic.type]
            decode = whole_messages(connections[0], self.path)
            for arrival in np.unique(one.arrival[np.isin(one.seconds(stamps), times)]).tolist():
                with reported(Path(str(reader.path)), f"topic '{topic.name}' is damaged"):
                    for _, received, raw in reader.messages(connections, arrival, arrival + 1):
                        message = decode(raw)
                        if stamp_of(received, message, stamps) in times:
                            yield stamp_of(received, message, stamps), message

    def _typed(
        self, topic: str, types: Sequence[str], stamps: str = "header", times: Times | None = None
    ) -> Iterator[tuple[float, Any]]:
        """Yield the messages, at some `times` or all, of a topic that must have one of these types."""
        result = self.topics.get(topic)
        if result is not None and result.type not in types:
            wanted = " or ".join(types)
            raise LogError(f"topic '{topic}' is {result.type}, not {wanted}", where=self.path, how="fix the rig")
        return self.messages(topic, stamps=stamps) if times is None else self._at(self._find(topic), times, stamps)


def _others(readers: Sequence[Reader], path: Path) -> list[str]:
    """Return the names of the logs in a bag's folder that are not files of the bag."""
    if not path.is_dir():
        return []
    own = {file.name for file in storage_files(path)}
    if Path(str(readers[0].path)) == path:  # by its metadata
        storages = getattr(getattr(readers[0], "storage", None), "storages", ())
        own = {Path(str(part.path)).name for part in storages}
    return [name for name in contents_of(path)[0] if name not in own]


def _refuse_several(readers: Sequence[Reader], path: Path) -> None:
    """Refuse a folder whose files overlap in time, so that they are not pieces of one recording."""
    known = [reader for reader in readers if not isinstance(reader, StreamedMcap) and reader.message_count]
    for before, after in pairwise(sorted(known, key=lambda reader: reader.start_time)):
        if before.end_time - after.start_time > _OVERLAP:
            first, second = (Path(str(reader.path)).name for reader in (before, after))
            what = f"holds several recordings: {second} begins before {first} ends"
            logs, others = contents_of(path)
            raise SeveralLogs(what, where=path, how="give each file by itself", logs=logs, others=others)
