"""Encodings and codecs of sensor_msgs/Image and CompressedImage, and their decoder.

rosbags-image 0.10 ignores `step`, which skews padded rows, treats 8UC1 and 8UC3 as colourless, and stops at a broken
image with an AssertionError.
"""

import re
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np

from offpiste.core.errors import LogError
from offpiste.core.limits import MOST_PIXELS, packaged_table
from offpiste.logs.measurements import Pixels, decoded_picture


@dataclass(frozen=True)
class Encoding:
    """Pixel layout of an encoding."""

    depth: int  # bits per value, 8 or 16
    channels: int  # values per pixel; of the brightness plane in planar layouts
    to_rgb: int | None  # conversion of OpenCV; None for RGB
    rows: int  # rows of data for two rows of pixels; more than two in planar layouts


PICTURES: Final = {
    name: Encoding(depth, channels, getattr(cv2, f"COLOR_{to_rgb}") if to_rgb else None, rows)
    for name, (depth, channels, to_rgb, rows) in packaged_table(__package__, "encodings.toml").items()
}
"""Encodings of sensor_msgs/image_encodings with colours or grey values."""
_NO_PICTURE: Final = re.compile(r"(8U|8S|16U|16S|32S|32F|64F)C[1-4]")
"""Encodings of depth and other numbers without a meaning as colours."""
_CODECS: Final = ("jpeg", "jpg", "png", "tiff", "webp", "bmp")
_ANOTHER: Final = "remove the camera from the rig, or give it the topic of its pictures"
_OF_FILES: Final = {1: PICTURES["mono8"], 3: PICTURES["bgr8"], 4: PICTURES["bgra8"]}
"""Layouts of files decoded by OpenCV, by their number of channels, for formats without an encoding."""


def pixels_of(message: Any, topic: str) -> Pixels | None:
    """Return the RGB of a sensor_msgs/CompressedImage or Image; None if its data is damaged."""
    try:
        return _decompressed(message, topic) if hasattr(message, "format") else _raw_pixels(message, topic)
    except cv2.error:  # a size that the layout cannot have
        return None


def _raw_pixels(message: Any, topic: str) -> Pixels | None:
    encoding = _encoding(message.encoding, topic)
    height, width, step = message.height, message.width, message.step
    rows, used = height * encoding.rows // 2, width * encoding.channels * encoding.depth // 8
    data = np.asarray(message.data, np.uint8)
    if step < used or data.size < rows * step or not 0 < height * width <= MOST_PIXELS:
        return None
    pixels = np.ascontiguousarray(data[: rows * step].reshape(rows, step)[:, :used])
    if encoding.depth == 16:
        pixels = pixels.view(">u2" if message.is_bigendian else "<u2").astype(np.uint16)
    return _to_rgb(pixels.reshape((rows, width, encoding.channels)), encoding)


def _decompressed(message: Any, topic: str) -> Pixels | None:
    """Return the RGB of a CompressedImage with the format `CODEC` or `ENCODING; CODEC compressed LAYOUT`.

    compressed_image_transport writes files in that layout, or else in the encoding. Files with another number of
    channels are read as BGR or grey.
    """
    name, _, rest = message.format.rpartition(";")
    name, (codec, *words) = name.strip(), rest.split() or [""]
    what = f"topic '{topic}' holds images compressed as '{message.format}', which"
    if codec == "compressedDepth":
        raise LogError(f"{what} are depth and no picture", how=_ANOTHER)
    if codec and codec.lower().removeprefix("image/") not in _CODECS:
        raise LogError(f"{what} is not supported", how=f"record one of: {', '.join(_CODECS)}; or uncompressed")
    encoding = _encoding(name, topic) if name else None
    layout = _encoding(words[-1], topic) if len(words) > 1 else None
    pixels = decoded_picture(np.asarray(message.data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.dtype not in (np.uint8, np.uint16):
        return None
    if encoding is not None and encoding.depth == 16 and pixels.dtype == np.uint8:
        if layout is None:
            raise LogError(f"{what} cut 16 bits to their lower 8", how="record png, or raw images of 8 bits")
        pixels = pixels.astype(np.uint16) * 257  # cv_bridge divided by it
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    fitting = (one for one in (layout, encoding, _OF_FILES.get(channels)) if one and one.channels == channels)
    found = next(fitting, None)
    return None if found is None else _to_rgb(pixels, found)


def _encoding(name: str, topic: str) -> Encoding:
    """Return an encoding by name; refuse unknown ones and those without colours."""
    if name in PICTURES:
        return PICTURES[name]
    what = f"topic '{topic}' holds images encoded as '{name}', which"
    if _NO_PICTURE.fullmatch(name):
        raise LogError(f"{what} are depth or other numbers and no picture", how=_ANOTHER)
    raise LogError(f"{what} is not supported", how=f"record one of: {', '.join(PICTURES)}; or compressed")


def _to_rgb(pixels: np.ndarray, encoding: Encoding) -> Pixels:
    if encoding.to_rgb is None:
        return pixels.copy()
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels), encoding.to_rgb))
