"""Images and point clouds of a log, and the mounted and calibrated sensors that measured them."""

import io
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

import cv2
import numpy as np
import PIL.Image
from jaxtyping import Bool, Float, Shaped, UInt8, UInt16

from offpiste.core.errors import LogError
from offpiste.core.limits import MOST_PIXELS
from offpiste.logs.log import Log, RawCloud
from offpiste.logs.transforms import Transform, between
from offpiste.rig.camera import CameraModel, model_from_intrinsics
from offpiste.rig.channels import SECONDS_PER_UNIT
from offpiste.rig.rig import Rig
from offpiste.rig.sensors import TIME_FIELDS, CameraSource, LidarSource

Pixels = UInt8[np.ndarray, "h w 3"] | UInt16[np.ndarray, "h w 3"]
"""RGB at the recorded bit depth (`in_eight_bits`)."""

_FORMATS: Final = ("BMP", "JPEG", "PNG", "PPM", "TIFF", "WEBP")
"""Image formats that are decoded, by Pillow's names."""
SWEEP: Final = 1.0
"""Largest time between a point and the stamp of its cloud [s]."""
_SHORTEST: Final = 0.002
"""Smallest duration of a scan over the time between scans; shorter ones have a unit that is 1000 times too small."""
_TYPICAL_PERIOD: Final = 0.1
"""Time between scans if it is unknown [s]."""
_SAMPLE: Final = 1000
"""Number of points of a cloud whose times are checked."""
_ORIGINS: Final = {"stamp": "the stamp", "epoch": "1970"}


@dataclass(frozen=True)
class Camera:
    """Camera of a log."""

    name: str
    model: CameraModel
    body_from_camera: Float[np.ndarray, "4 4"]  # camera axes are z forward, x right, y down
    source: CameraSource  # entry in the rig


@dataclass(frozen=True)
class Lidar:
    """LiDAR of a log (see `Camera`)."""

    name: str
    body_from_lidar: Float[np.ndarray, "4 4"]
    source: LidarSource


@dataclass(frozen=True)
class Image:
    """RGB image."""

    time: float  # stamp, corrected by the rig's delay [s]
    camera: str  # name in `SensorLog.cameras`
    pixels: UInt8[np.ndarray, "h w 3"]


@dataclass(frozen=True)
class Cloud:
    """Scan whose points are finite, within range and not on the vehicle itself."""

    time: float  # stamp, corrected by the rig's delay [s]
    lidar: str  # name in `SensorLog.lidars`
    points: Float[np.ndarray, "n 3"]  # each in the LiDAR's frame at the time of the point [m]
    offset: Float[np.ndarray, " n"] | None  # time of each point after `time` [s]; None if points have no times
    intensity: Float[np.ndarray, " n"]  # as recorded; NaN if not recorded

    @property
    def times(self) -> Float[np.ndarray, " n"]:
        """Time of each point [s]."""
        return self.time + (np.zeros(len(self.points)) if self.offset is None else self.offset)


def camera_of(log: Log, rig: Rig, name: str, entry: CameraSource, transforms: Sequence[Transform]) -> Camera:
    """Return a camera of a log, calibrated and mounted by the rig or else by the log's messages."""
    camera_from_image = np.eye(4)
    if entry.intrinsics is not None:
        model = model_from_intrinsics(entry.intrinsics)
    elif entry.info not in log.topics:
        what = f"'{name}': images without calibration: no topic '{entry.info}'"
        raise LogError(what, where=log.path, how=f"give cameras.{name}.intrinsics in the rig")
    else:
        model, camera_from_image = log.camera_model(entry.info, rectified=entry.rectified)
    return Camera(name, model, body_from_sensor(log, rig, entry, transforms) @ camera_from_image, entry)


def lidar_of(log: Log, rig: Rig, name: str, entry: LidarSource, transforms: Sequence[Transform]) -> Lidar:
    """Return a LiDAR of a log, mounted (see `camera_of`)."""
    return Lidar(name, body_from_sensor(log, rig, entry, transforms), entry)


def body_from_sensor(
    log: Log, rig: Rig, entry: CameraSource | LidarSource, transforms: Sequence[Transform]
) -> Float[np.ndarray, "4 4"]:
    """Return the mounting of a sensor by the rig, or else by the log's transforms."""
    if entry.mounting is not None:
        return entry.mounting.matrix(optical=isinstance(entry, CameraSource))
    return between(transforms, rig.frames.body, entry.frame or log.frame(entry.topic), path=log.path)


def refuse_rough(log: Log, entries: Mapping[str, CameraSource | LidarSource]) -> None:
    """Refuse mountings that are rough guesses."""
    for name, entry in entries.items():
        if entry.mounting is not None and entry.mounting.looks:
            what = f"the mounting of '{name}' is a rough guess, looks = \"{entry.mounting.looks}\""
            how = "run `offpiste inspect LOG --rig RIG --estimate-mountings`, and put its lines into the rig"
            raise LogError(what, where=log.path, how=how)


def decoded_picture(data: UInt8[np.ndarray, " n"], mode: int = cv2.IMREAD_COLOR) -> Any:
    """Decode an image file to RGB of 8 bits, or by another `mode` of OpenCV; None if damaged or above the limit.

    The header is checked first, because a few of its bytes could ask for gigabytes.
    """
    if not 0 < _pixels_of(data) <= MOST_PIXELS:
        return None
    try:
        decoded = cv2.imdecode(data, mode)
    except cv2.error:
        return None
    return cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB) if decoded is not None and mode == cv2.IMREAD_COLOR else decoded


def _pixels_of(data: UInt8[np.ndarray, " n"]) -> int:
    """Return the number of pixels that an image's header declares; 0 for an unknown format."""
    try:
        with warnings.catch_warnings(action="ignore"):
            picture = PIL.Image.open(io.BytesIO(data.data), formats=_FORMATS)  # reads the header only
        return picture.width * picture.height
    except PIL.Image.DecompressionBombError:
        return MOST_PIXELS + 1
    except Exception:  # noqa: BLE001  (Pillow lets errors of struct and others through)
        return 0


def in_eight_bits(pixels: Pixels, camera: Camera) -> UInt8[np.ndarray, "h w 3"]:
    """Convert a 16-bit RGB image to 8 bits, by the bit depth of the rig so that all images are scaled alike."""
    if pixels.dtype == np.uint8:
        return np.asarray(pixels, np.uint8)
    bits, highest, key = camera.source.bits, int(pixels.max(initial=0)), f"cameras.{camera.name}.bits"
    if not bits or highest >> bits:
        said = f"has values up to {highest}, and {key} = {bits}" if bits else f"has images of 16 bits without {key}"
        how = f"{key} = {used_bits(highest)}, or as many bits as it uses; values in this image reach {highest}"
        raise LogError(f"'{camera.name}' {said}", where=f"topic '{camera.source.topic}'", how=how)
    scale = np.round(np.arange(1 << bits) * (255 / ((1 << bits) - 1))).astype(np.uint8)
    return scale[pixels]


def used_bits(highest: int) -> int:
    """Return the bit depth of a camera whose largest value is `highest`: 8, 10, 12, 14 or 16."""
    return max(8, highest.bit_length() + highest.bit_length() % 2)


def cloud_from_records(raw: RawCloud, lidar: Lidar, period: float = 0.0) -> Cloud:
    """Return the usable points of a recorded cloud; points whose own time is far from the stamp are dropped.

    Args:
        period: time between scans [s]; 0 if unknown.
    """
    names = raw.points.dtype.names or ()
    source = lidar.source
    for field in ("x", "y", "z", *((source.time_field,) if source.time_field else ())):
        if field not in names:
            what = f"'{lidar.name}': its points have no field '{field}'"
            raise LogError(what, where=f"topic '{source.topic}'", how=f"they have: {', '.join(names)}")
    points = np.empty((len(raw.points), 3))
    for column, axis in zip(points.T, "xyz", strict=True):
        column[:] = raw.points[axis]
    keep = usable_points(points, lidar)
    offset = None
    if source.time_field:
        misread = misread_times(raw, source, period)
        if misread is not None and misread.entries:
            raise LogError(f"'{lidar.name}': {misread.what}", how=misread.remedy(lidar.name))
        offset = _offsets(raw.time, raw.points[source.time_field], source.time_unit, source.time_origin)
        keep &= np.abs(offset) <= SWEEP  # also drops NaN
        offset = offset[keep]
    intensity = raw.points["intensity"][keep] if "intensity" in names else np.full(keep.sum(), np.nan)
    return Cloud(raw.time - source.delay, lidar.name, points[keep], offset, intensity.astype(np.float64))


def usable_points(points_lidar: Float[np.ndarray, "n 3"], lidar: Lidar) -> Bool[np.ndarray, " n"]:
    """Mark points that are finite, within range (drivers write 0, 0, 0 for no echo) and not on the vehicle itself."""
    source, mounting = lidar.source, lidar.body_from_lidar
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.sqrt(np.einsum("nk,nk->n", points_lidar, points_lidar))
    usable = (distance > 0) & (distance >= source.min_range) & (distance <= source.max_range) & (distance < np.inf)
    if source.own_body is not None:
        low, high = np.array(source.own_body, np.float64)
        furthest = np.linalg.norm(np.maximum(np.abs(low - mounting[:3, 3]), np.abs(high - mounting[:3, 3])))
        near = np.flatnonzero(usable & (distance <= furthest + 1e-6))
        place = points_lidar[near] @ mounting[:3, :3].T + mounting[:3, 3]
        usable[near] = ~((place >= low) & (place <= high)).all(axis=1)
    return usable


@dataclass(frozen=True)
class MisreadTimes:
    """Point times that are inconsistent with the rig."""

    what: str  # the fault in words
    entries: dict[str, str]  # corrected entries of the LiDAR in the rig; empty if no unit and origin fit

    def remedy(self, name: str) -> str:
        """Return the lines of the rig that correct the fault."""
        if self.entries:
            return lines(name, self.entries)
        return f"remove lidars.{name}.time_field, or record with the LiDAR's clock and its stamps synchronised"


def lines(name: str, entries: dict[str, str]) -> str:
    """Return entries of a LiDAR as lines of a rig."""
    return "; ".join(f'lidars.{name}.{key} = "{value}"' for key, value in entries.items())


def misread_times(raw: RawCloud, source: LidarSource, period: float = 0.0) -> MisreadTimes | None:
    """Return the fault of a cloud's point times as the rig reads them; None if they are plausible.

    Args:
        period: time between scans [s]; 0 if unknown.
    """
    values = _times_of_echoes(raw, source.time_field)
    middle, span = _extent(_offsets(raw.time, values, source.time_unit, source.time_origin))
    if _fits(middle, span, period):
        return None
    fits = next(_fitting(raw.time, values, period), None)
    read = f"'{source.time_field}', read in {source.time_unit} since {_ORIGINS[source.time_origin]}"
    if abs(middle) > SWEEP:
        what = f"{read}, puts points {abs(middle):.3g} s from their scan's stamp"
    else:
        what = f"{read}, takes {span:.2g} s for scans that come every {period:.2g} s"
    if fits is None:
        return MisreadTimes(f"{what}, and no other unit or origin fits", {})
    now = {"time_unit": source.time_unit, "time_origin": source.time_origin}
    entries = dict(zip(now, fits, strict=True))
    return MisreadTimes(what, {key: value for key, value in entries.items() if value != now[key]})


def proposed_times(raw: RawCloud, period: float = 0.0) -> dict[str, str]:
    """Return entries of a LiDAR in the rig that read its point times; empty if no field with a usual name fits."""
    for field in TIME_FIELDS:
        values = _times_of_echoes(raw, field)
        varying = _extent(values.astype(np.float64))[1] > 0  # constant times: compensated already, or not filled in
        fits = next(_fitting(raw.time, values, period), None) if varying else None
        if fits is not None:
            return {"time_field": field, "time_unit": fits[0], "time_origin": fits[1]}
    return {}


def _offsets(time: float, values: Shaped[np.ndarray, " n"], unit: str, origin: str) -> Float[np.ndarray, " n"]:
    """Return the time of each point after its cloud's stamp [s]."""
    seconds = values.astype(np.float64) * SECONDS_PER_UNIT[unit]
    return seconds - time if origin == "epoch" else seconds


def _fitting(time: float, values: Shaped[np.ndarray, " n"], period: float) -> Iterator[tuple[str, str]]:
    """Yield the units and origins that put the points of a scan near its stamp."""
    for origin, unit in product(_ORIGINS, ("s", "ms", "us", "ns")):
        if _fits(*_extent(_offsets(time, values, unit, origin)), period or _TYPICAL_PERIOD):
            yield unit, origin


def _fits(middle: float, span: float, period: float) -> bool:
    return abs(middle) <= SWEEP and not 0 < span < _SHORTEST * period


def _extent(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the median and the 5 to 95 % range of the finite values; zeros if there are none."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, 0.0
    low, middle, high = np.quantile(finite, (0.05, 0.5, 0.95))
    return float(middle), float(high - low)


def _times_of_echoes(raw: RawCloud, field: str) -> Shaped[np.ndarray, " n"]:
    """Return times of some points with an echo (drivers leave others at zero); empty if a field is missing."""
    if not {field, *"xyz"} <= set(raw.points.dtype.names or ()):
        return np.empty(0)
    points = raw.points[:: max(1, len(raw.points) // _SAMPLE)]
    distance = np.abs(points["x"]) + np.abs(points["y"]) + np.abs(points["z"])
    return np.asarray(points[field][np.isfinite(distance) & (distance > 0)])
