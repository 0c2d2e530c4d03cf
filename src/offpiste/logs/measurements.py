"""Images and point clouds as measured, and the cameras and LiDARs that measured them."""

import io
import warnings
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import PIL.Image
from jaxtyping import Bool, Float, Shaped, UInt8, UInt16

from offpiste.core.errors import LogError
from offpiste.core.limits import MOST_PIXELS
from offpiste.logs.log import RawCloud
from offpiste.logs.point_times import SWEEP, misread_times, offsets
from offpiste.rig.camera import CameraModel
from offpiste.rig.sensors import CameraSource, LidarSource

Pixels = UInt8[np.ndarray, "h w 3"] | UInt16[np.ndarray, "h w 3"]
"""RGB in as many bits as were recorded (`in_eight_bits`)."""

_FORMATS: Final = ("BMP", "JPEG", "PNG", "PPM", "TIFF", "WEBP")
"""Formats of pictures that are decoded, by Pillow's names."""


@dataclass(frozen=True)
class Camera:
    """A camera of a log.

    Attributes:
        body_from_camera: z forward, x right, y down.
        source: its entry in the rig: delay, masks.
    """

    name: str
    model: CameraModel
    body_from_camera: Float[np.ndarray, "4 4"]
    source: CameraSource


@dataclass(frozen=True)
class Lidar:
    """A LiDAR of a log (see `Camera`)."""

    name: str
    body_from_lidar: Float[np.ndarray, "4 4"]
    source: LidarSource


@dataclass(frozen=True)
class Image:
    """An image at the moment it was taken.

    Attributes:
        time: its stamp, the rig's delay removed [s].
        camera: name in `SensorLog.cameras`.
        pixels: RGB.
    """

    time: float
    camera: str
    pixels: UInt8[np.ndarray, "h w 3"]


@dataclass(frozen=True)
class Cloud:
    """A scan: points that are finite, within range and not on the vehicle itself.

    Attributes:
        time: the stamp, the rig's delay removed [s].
        lidar: name in `SensorLog.lidars`.
        points: each in the LiDAR's frame at its own moment [m].
        offset: of each point's moment from `time` [s]; None where points have no times.
        intensity: as recorded, NaN where there is none.
    """

    time: float
    lidar: str
    points: Float[np.ndarray, "n 3"]
    offset: Float[np.ndarray, " n"] | None
    intensity: Float[np.ndarray, " n"]

    @property
    def times(self) -> Float[np.ndarray, " n"]:
        """Moment of each point [s]."""
        return self.time + (np.zeros(len(self.points)) if self.offset is None else self.offset)


def decoded_picture(
    data: UInt8[np.ndarray, " n"], *, grey: bool = False, as_stored: bool = False
) -> Shaped[np.ndarray, "h w *c"] | None:
    """BGR, or grey, of a PNG, a JPEG or whatever else OpenCV decodes; None where it cannot, or will not for its size.

    Args:
        as_stored: channels and depth of the file, which are otherwise converted to 8 bits.

    Its header is read first: a few bytes of it could ask for gigabytes.
    """
    if not 0 < _pixels_of(data) <= MOST_PIXELS:
        return None
    mode = cv2.IMREAD_UNCHANGED if as_stored else cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR
    try:
        decoded = cv2.imdecode(data, mode)
    except cv2.error:
        return None
    return None if decoded is None else np.asarray(decoded)


def _pixels_of(data: UInt8[np.ndarray, " n"]) -> int:
    """Pixels that a picture's header promises; 0 where it is none that is known."""
    try:
        with warnings.catch_warnings(action="ignore"):
            picture = PIL.Image.open(io.BytesIO(data.data), formats=_FORMATS)  # reads no more than its header
        return picture.width * picture.height
    except PIL.Image.DecompressionBombError:
        return MOST_PIXELS + 1
    except Exception:  # noqa: BLE001  (Pillow lets those of struct and others through)
        return 0


def in_eight_bits(pixels: Pixels, camera: Camera) -> UInt8[np.ndarray, "h w 3"]:
    """RGB of 8 bits; 16 bits are scaled by those that the rig says are used, so that all images are scaled alike.

    Raises:
        LogError: the rig does not say how many bits are used, or values need more.
    """
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
    """Bit depth of a camera whose largest value is `highest`: 8, 10, 12, 14 or 16."""
    return max(8, highest.bit_length() + highest.bit_length() % 2)


def cloud_from_records(raw: RawCloud, lidar: Lidar, period: float = 0.0) -> Cloud:
    """Usable points of a recorded cloud; those whose own time is far from the stamp are not.

    Args:
        period: time between scans; 0 where it is not known [s].

    Raises:
        LogError: its points lack x, y, z or the time that the rig names, or their times are of another unit or origin.
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
        offset = offsets(raw.time, raw.points[source.time_field], source.time_unit, source.time_origin)
        keep &= np.abs(offset) <= SWEEP  # where it is not a number, too
        offset = offset[keep]
    intensity = raw.points["intensity"][keep] if "intensity" in names else np.full(keep.sum(), np.nan)
    return Cloud(raw.time - source.delay, lidar.name, points[keep], offset, intensity.astype(np.float64))


def usable_points(points_lidar: Float[np.ndarray, "n 3"], lidar: Lidar) -> Bool[np.ndarray, " n"]:
    """Points that are finite, within range (drivers write 0, 0, 0 for no echo) and not on the vehicle itself."""
    from offpiste.logs.usable_points import mark_usable  # here: numbers alone are read without a compiler

    source, usable = lidar.source, np.empty(len(points_lidar), bool)
    low, high = np.array(source.own_body or np.full((2, 3), np.nan), np.float64)
    place = np.ascontiguousarray(lidar.body_from_lidar, np.float64)
    mark_usable(np.ascontiguousarray(points_lidar), source.min_range, source.max_range, place, low, high, usable)
    return usable
