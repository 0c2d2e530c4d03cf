"""Calibrated and cleaned images and clouds of a log sorted by time, read through its rig."""

import heapq
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import dropwhile, takewhile
from typing import Final, TypeVar

import numpy as np
from jaxtyping import Float, Int

from offpiste.core.errors import LogError
from offpiste.logs.channel import increasing
from offpiste.logs.clock_drift import DRIFT_LIMIT, clock_difference
from offpiste.logs.drive import drive_from_log
from offpiste.logs.log import Log, RawCloud, RawImage
from offpiste.logs.measurements import (
    Camera,
    Cloud,
    Image,
    Lidar,
    camera_of,
    cloud_from_records,
    in_eight_bits,
    lidar_of,
    misread_times,
    refuse_rough,
)
from offpiste.logs.poses import Poses, jump_note, poses_from_drive
from offpiste.logs.transforms import listed
from offpiste.rig.rig import Rig
from offpiste.rig.sensors import CameraSource, LidarSource

_USELESS: Final = 10
"""Number of consecutive unusable messages after which a sensor is refused."""
_LATE: Final = 1.0
"""Largest unreported gap of a sensor, also at either end of the drive [s]."""
_DRIFTS: Final = 0.02
"""Smallest reported drift of a clock [s]: 0.2 m at 10 m/s."""
_OFFSET: Final = 0.5
"""Smallest reported offset of a clock [s]; no sensor has such a latency."""
_HELD: Final = 20
"""Number of messages held to sort them, which transports that shuffle messages do not exceed."""
_T = TypeVar("_T")


class SensorLog:
    """Cameras, LiDARs and poses of a log, opened by `open_sensors`.

    Attributes:
        cameras, lidars: by name, without optional ones that the log lacks.
        poses: `world_from_body`.
    """

    def __init__(
        self,
        log: Log,
        rig: Rig,
        cameras: dict[str, Camera],
        lidars: dict[str, Lidar],
        poses: Poses,
        notes: list[str],
    ) -> None:
        self.path, self.rig = log.path, rig
        self.cameras, self.lidars, self.poses = cameras, lidars, poses
        self._log, self._notes = log, notes
        self._stamps: dict[str, Float[np.ndarray, " n"]] = {}
        self._read: Counter[str] = Counter()
        self._dropped: Counter[tuple[str, str]] = Counter()

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on omitted sensors and dropped messages, as far as the log has been read."""
        dropped = (f"{name}: {n} of {self._read[name]} {what}" for (name, what), n in sorted(self._dropped.items()))
        return (*self._notes, *dropped)

    def stream(
        self, names: Iterable[str] | None = None, *, start: float = -np.inf, end: float = np.inf
    ) -> Iterator[Image | Cloud]:
        """Yield images and clouds sorted by time; one message per sensor is held, or a few to sort them.

        Args:
            names: names of cameras and LiDARs; all by default.
            start, end: first and last time [s].
        """
        chosen = (*self.cameras, *self.lidars) if names is None else tuple(names)
        streams = [_between(self._measured(name, None), start, end) for name in chosen]
        yield from heapq.merge(*streams, key=lambda measured: measured.time)

    def picked(self, chosen: Mapping[str, Int[np.ndarray, " n"]]) -> Iterator[Image | Cloud]:
        """Yield some images and clouds sorted by time; formats with an index read no others.

        Args:
            chosen: indices into `stamps` by the sensor's name.
        """
        streams = [self._measured(name, self._recorded_stamps(name)[index]) for name, index in chosen.items()]
        yield from heapq.merge(*streams, key=lambda measured: measured.time)

    def _measured(self, name: str, times: Float[np.ndarray, " n"] | None) -> Iterator[Image | Cloud]:
        """Yield the images or clouds of a sensor, with given recorded stamps or all."""
        log, topic, stamps = self._log, self._sensor(name).source.topic, self.rig.clock.stamps
        if name in self.lidars:
            return self._clouds(self.lidars[name], log.clouds(topic, stamps=stamps, times=times))
        return self._images(self.cameras[name], log.images(topic, stamps=stamps, times=times))

    def stamps(self, name: str) -> Float[np.ndarray, " n"]:
        """Return the times of a sensor's messages in file order [s], without decoding them."""
        return self._recorded_stamps(name) - self._sensor(name).source.delay

    def raw_clouds(self, name: str) -> Iterator[RawCloud]:
        """Yield the clouds of a LiDAR as recorded, in file order."""
        return self._log.clouds(self.lidars[name].source.topic, stamps=self.rig.clock.stamps)

    def period(self, name: str) -> float:
        """Return the time between a sensor's messages [s]; 0 for less than two."""
        stamps = np.sort(self._recorded_stamps(name))
        return float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0

    def _recorded_stamps(self, name: str) -> Float[np.ndarray, " n"]:
        if name not in self._stamps:
            self._stamps[name] = self._log.stamps(self._sensor(name).source.topic, stamps=self.rig.clock.stamps)
        return self._stamps[name]

    def coverage(self) -> tuple[str, ...]:
        """Return notes on jumps of the poses and on sensors that start late, stop early, pause or drift."""
        (first, last), notes = self.poses.span, jump_note(self.poses)
        for name in (*self.cameras, *self.lidars):
            time = self.stamps(name)
            inside = np.sort(time[(time >= first) & (time <= last)])
            if not len(inside):
                what = f"'{name}' has no message from {first:.3f} to {last:.3f} s, where the pose is known"
                raise LogError(what, where=self.path, how='use clock.stamps = "receive", or fix its delay')
            notes += _span_notes(name, inside, (first, last)) + self._clock(name, time)
        return tuple(notes)

    def _clock(self, name: str, stamps: Float[np.ndarray, " n"]) -> list[str]:
        """Return a note on a sensor's clock that differs from the poses'; refuse one that drifts too far."""
        position, topic = self.rig.channels["position"], self._sensor(name).source.topic
        recorded = self._log.has_arrivals and self.rig.clock.stamps == "header"
        if not recorded or position.topic not in self._log.topics:
            return []
        arrivals, pose_arrivals = (self._log.stamps(t, stamps="receive") for t in (topic, position.topic))
        pose_stamps = self._log.stamps(position.topic) - position.delay
        offset, drift = clock_difference(stamps, arrivals, pose_stamps, pose_arrivals) or (0.0, 0.0)
        if abs(drift) > DRIFT_LIMIT:
            what = f"'{name}': stamps drift against the pose clock by {abs(drift):.2f} s over the drive"
            raise LogError(what, where=self.path, how='use clock.stamps = "receive", or remove the sensor from the rig')
        if abs(drift) > _DRIFTS:
            return [f"{name}: stamps drift against the pose clock by {1000 * abs(drift):.0f} ms over the drive"]
        side = "before" if offset > 0 else "after"
        what = f"{name}: stamped {abs(offset):.2f} s {side} poses that arrive with it; fix its clock or its delay"
        return [what] if abs(offset) > _OFFSET else []

    def _sensor(self, name: str) -> Camera | Lidar:
        return self.cameras[name] if name in self.cameras else self.lidars[name]

    def _images(self, camera: Camera, images: Iterator[RawImage]) -> Iterator[Image]:
        def convert(raw: RawImage) -> Image | str:
            if raw.pixels is None:
                return "images cannot be decoded and were dropped"
            height, width = raw.pixels.shape[:2]
            if (width, height) != camera.model.size:
                size = "{}x{}".format(*camera.model.size)
                what = f"'{camera.name}' has images of {width}x{height} pixels, but a calibration for {size}"
                raise LogError(what, where=self.path, how="give the calibration of these images in the rig")
            return Image(raw.time - camera.source.delay, camera.name, in_eight_bits(raw.pixels, camera))

        return self._converted(camera.name, images, convert)

    def _clouds(self, lidar: Lidar, clouds: Iterator[RawCloud]) -> Iterator[Cloud]:
        period, timed = self.period(lidar.name), lidar.source.time_field

        def convert(raw: RawCloud) -> Cloud | str:
            cloud = cloud_from_records(raw, lidar, period)
            if len(cloud.points):
                return cloud
            if timed and misread_times(raw, lidar.source, period) is not None:
                return f"clouds have points whose '{timed}' is far from the stamp and were dropped"
            return "clouds have no usable point and were dropped"

        return self._converted(lidar.name, clouds, convert)

    def _converted(
        self, name: str, raw: Iterator[RawImage | RawCloud], convert: Callable[..., _T | str]
    ) -> Iterator[_T]:
        """Yield usable messages sorted by time, count the others, and refuse senders that take turns."""
        latest, useless = -np.inf, 0
        stamps = self._recorded_stamps(name)
        if self.rig.clock.sort:
            stamps, raw = np.sort(stamps), _sorted(raw)
        rising = set(stamps[increasing(stamps)].tolist())
        self._read[name] = 0
        for key in [key for key in self._dropped if key[0] == name]:
            del self._dropped[key]
        frames = [""]
        for measured in raw:
            if measured.frame not in ("", frames[-1]):
                if measured.frame in frames:  # a driver that restarts with another frame does not return to the first
                    what = f"'{name}': its topic has several senders, of frames '{measured.frame}' and '{frames[-1]}'"
                    raise LogError(what, where=self.path, how="give each a topic of its own, and record it again")
                frames.append(measured.frame)
            self._read[name] += 1
            if measured.time not in rising or not measured.time > latest:
                self._dropped[name, "stamps repeat or go back; those messages were dropped"] += 1
                continue
            converted = convert(measured)
            if isinstance(converted, str):
                self._dropped[name, converted] += 1
                useless += 1
                if useless >= _USELESS:
                    what = f"'{name}': {useless} {converted.removesuffix(' and were dropped')}, one after the other"
                    how = "fix its entry in the rig, record it again, or remove the sensor from the rig"
                    raise LogError(what, where=self.path, how=how)
                continue
            latest, useless = measured.time, 0
            yield converted


def open_sensors(log: Log, rig: Rig, *, poses: Poses | None = None, rough: bool = False) -> SensorLog:
    """Open the cameras, LiDARs and poses of a log.

    Args:
        poses: poses in place of the log's.
        rough: accept mountings that are rough guesses (`Mounting.looks`).

    Raises:
        LogError: the log has no images or clouds, or lacks a topic, a calibration or a transform; or a mounting is a
            rough guess.
        RigError: the rig's channels do not give full poses.
    """
    if not log.has_sensors:
        raise log.no_sensors()
    absent = []
    entries: dict[str, CameraSource | LidarSource] = {**rig.cameras, **rig.lidars}
    present: dict[str, CameraSource | LidarSource] = {}
    for name, entry in entries.items():
        result = log.topics.get(entry.topic)
        if result is not None and result.count:
            present[name] = entry
        elif entry.optional:
            absent.append(name)
        else:
            how = f"available: {', '.join(listed(sorted(log.topics))) or 'none'}; or set optional = true"
            raise LogError(f"'{name}': no messages on topic '{entry.topic}'", where=log.path, how=how)
    if not present:
        what = f"none of the cameras and LiDARs of rig '{rig.name}' is in it"
        raise LogError(what, where=log.path, how="fix the rig")
    if not rough:
        refuse_rough(log, present)
    transforms = log.transforms(rig.frames.topics)
    cameras = {n: camera_of(log, rig, n, e, transforms) for n, e in present.items() if isinstance(e, CameraSource)}
    lidars = {n: lidar_of(log, rig, n, e, transforms) for n, e in present.items() if isinstance(e, LidarSource)}
    known = poses or poses_from_drive(drive_from_log(log, rig))
    notes = [f"no messages of {', '.join(absent)}: the log is read without"] if absent else []
    return SensorLog(log, rig, cameras, lidars, known, notes)


def _sorted(raw: Iterator[RawImage | RawCloud]) -> Iterator[RawImage | RawCloud]:
    """Sort messages by their stamps, except for those more than `_HELD` messages late."""
    held: list[tuple[float, int, RawImage | RawCloud]] = []
    for number, message in enumerate(raw):
        heapq.heappush(held, (message.time, number, message))
        if len(held) > _HELD:
            yield heapq.heappop(held)[2]
    yield from (message for _, _, message in sorted(held, key=lambda one: one[:2]))


def _between(measured: Iterator[Image | Cloud], start: float, end: float) -> Iterator[Image | Cloud]:
    until_end = takewhile(lambda item: item.time <= end, measured)
    return dropwhile(lambda item: item.time < start, until_end)


def _span_notes(name: str, inside: Float[np.ndarray, " n"], span: tuple[float, float]) -> list[str]:
    """Return notes on a sensor that starts late, stops early or pauses, from its sorted stamps within the span [s]."""
    (first, last), notes = span, []
    if inside[0] - first > _LATE:
        notes.append(f"{name}: starts {inside[0] - first:.1f} s after the poses")
    if last - inside[-1] > _LATE:
        notes.append(f"{name}: stops {last - inside[-1]:.1f} s before the poses")
    steps = np.diff(inside)
    if len(steps) and steps.max() > max(_LATE, 5 * np.median(steps)):
        at = inside[int(steps.argmax())] - first
        notes.append(f"{name}: pauses for {steps.max():.1f} s, {at:.1f} s after the poses start")
    return notes
