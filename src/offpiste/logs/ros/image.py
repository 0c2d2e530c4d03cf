"""sensor_msgs/Image and CompressedImage to RGB.

rosbags-image 0.10 does not serve: it ignores `step`, so padded rows come out skewed or not at all, takes 8UC1 and 8UC3
for no colours, and stops at a broken image with an AssertionError.
"""

from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import UInt8

from offpiste.errors import LogError

_CHANNELS: Final = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1, "8UC1": 1, "8UC3": 3} | {
    f"bayer_{pattern}8": 1 for pattern in ("rggb", "bggr", "gbrg", "grbg")
}
_TO_RGB: Final[dict[str, int]] = {
    "bgr8": cv2.COLOR_BGR2RGB,
    "8UC3": cv2.COLOR_BGR2RGB,
    "rgba8": cv2.COLOR_RGBA2RGB,
    "bgra8": cv2.COLOR_BGRA2RGB,
    "mono8": cv2.COLOR_GRAY2RGB,
    "8UC1": cv2.COLOR_GRAY2RGB,
    # OpenCV names a Bayer pattern by the second row's second and third pixel, ROS by the first row's first two.
    "bayer_rggb8": cv2.COLOR_BayerBG2RGB,
    "bayer_bggr8": cv2.COLOR_BayerRG2RGB,
    "bayer_gbrg8": cv2.COLOR_BayerGR2RGB,
    "bayer_grbg8": cv2.COLOR_BayerGB2RGB,
}


def decompressed(message: Any) -> UInt8[np.ndarray, "h w 3"] | None:
    """RGB of a JPEG, a PNG or whatever else OpenCV decodes; None where it cannot."""
    data = np.asarray(message.data, np.uint8)
    decoded = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    if decoded is None:
        return None
    return _to_rgb(np.asarray(decoded, np.uint8), cv2.COLOR_BGR2RGB)


def raw_pixels(message: Any, topic: str) -> UInt8[np.ndarray, "h w 3"] | None:
    """RGB of a sensor_msgs/Image; None where its sizes do not fit its data.

    Raises:
        LogError: an encoding that is not supported.
    """
    channels = _CHANNELS.get(message.encoding)
    if channels is None:
        what = f"topic '{topic}' holds images encoded as '{message.encoding}', which is not supported"
        raise LogError(what, how=f"record one of: {', '.join(_CHANNELS)}, or compressed")
    height, width, step = message.height, message.width, message.step
    data = np.asarray(message.data, np.uint8)
    if step < width * channels or data.size < height * step or not height * width:
        return None
    pixels = data[: height * step].reshape(height, step)[:, : width * channels]
    pixels = pixels.reshape((height, width, channels) if channels > 1 else (height, width))
    code = _TO_RGB.get(message.encoding)
    return pixels.copy() if code is None else _to_rgb(pixels, code)


def _to_rgb(pixels: np.ndarray, code: int) -> UInt8[np.ndarray, "h w 3"]:
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels), code), np.uint8)
