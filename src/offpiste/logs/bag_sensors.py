"""Cameras and LiDARs of a ROS bag."""

from collections.abc import Iterator, Sequence
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from offpiste.errors import LogError
from offpiste.geometry import rotation_from_quaternion
from offpiste.logs.bags import BagLog
from offpiste.logs.camera_model import CameraModel, model_from_message
from offpiste.logs.pointcloud import points_from_message
from offpiste.logs.sensor_source import RawCloud, RawImage, SensorSource, Transform

_IMAGES: Final = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")
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


class BagSensors(SensorSource):
    """Images, PointCloud2, CameraInfo and TF of ROS 1 and ROS 2 bags."""

    def __init__(self, log: BagLog, stamps: str) -> None:
        self.log: BagLog = log
        self._stamps = stamps

    def transforms(self, topics: Sequence[str]) -> list[Transform]:
        """Of tf2_msgs/TFMessage; the first of each pair of frames."""
        found: dict[tuple[str, str], Transform] = {}
        for topic in topics:
            if topic in self.log.topics:
                for _, message in self._messages(topic, ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")):
                    for transform in map(_transform, message.transforms):
                        found.setdefault((transform.parent, transform.child), transform)
        return list(found.values())

    def camera_model(self, topic: str, *, rectified: bool) -> tuple[CameraModel, Float[np.ndarray, "4 4"]]:
        """Of the topic's first CameraInfo."""
        first = next(self._messages(topic, ("sensor_msgs/msg/CameraInfo",)), None)
        if first is None:
            how = "give the camera's intrinsics in the rig"
            raise LogError(f"topic '{topic}' is empty: images without calibration", where=self.log.path, how=how)
        return model_from_message(first[1], topic, rectified=rectified)

    def frame(self, topic: str) -> str:
        """Of the first message's header."""
        _, message = next(self.log.messages(topic, stamps=self._stamps), (0.0, None))
        if message is None:
            raise LogError(f"topic '{topic}' is empty", where=self.log.path, how="remove the sensor from the rig")
        return _frame(message)

    def stamps(self, topic: str) -> Float[np.ndarray, " n"]:
        """Of headers, or of arrival."""
        return self.log.stamps(topic, stamps=self._stamps)

    def arrivals(self, topic: str) -> Float[np.ndarray, " n"] | None:
        """By the recorder's clock; None where that is what counts already, or there is no such topic."""
        if self._stamps == "receive" or topic not in self.log.topics:
            return None
        return self.log.stamps(topic, stamps="receive")

    def images(self, topic: str) -> Iterator[RawImage]:
        """Of sensor_msgs/CompressedImage and Image."""
        for time, message in self._messages(topic, _IMAGES):
            decoded = _decompressed(message) if hasattr(message, "format") else _pixels(message, topic)
            yield RawImage(time, _frame(message), decoded)

    def clouds(self, topic: str) -> Iterator[RawCloud]:
        """Of sensor_msgs/PointCloud2."""
        for time, message in self._messages(topic, ("sensor_msgs/msg/PointCloud2",)):
            yield RawCloud(time, _frame(message), points_from_message(message))

    def _messages(self, topic: str, types: Sequence[str]) -> Iterator[tuple[float, Any]]:
        found = self.log.topics.get(topic)
        if found is not None and found.type not in types:
            wanted = " or ".join(types)
            raise LogError(f"topic '{topic}' is {found.type}, not {wanted}", where=self.log.path, how="mend the rig")
        return self.log.messages(topic, stamps=self._stamps)


def _transform(message: Any) -> Transform:
    t, q = message.transform.translation, message.transform.rotation
    matrix = np.eye(4)
    matrix[:3, 3] = t.x, t.y, t.z
    with np.errstate(invalid="ignore"):  # a quaternion of zeros is found where the transform is used
        matrix[:3, :3] = rotation_from_quaternion(np.array([[q.x, q.y, q.z, q.w]]))[0]
    return Transform(message.header.frame_id.lstrip("/"), message.child_frame_id.lstrip("/"), matrix)


def _frame(message: Any) -> str:
    return str(message.header.frame_id).lstrip("/")


def _decompressed(message: Any) -> UInt8[np.ndarray, "h w 3"] | None:
    """JPEG, PNG and whatever else OpenCV reads."""
    data = np.asarray(message.data, np.uint8)
    decoded = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    if decoded is None:
        return None
    return _to_rgb(np.asarray(decoded, np.uint8), cv2.COLOR_BGR2RGB)


def _pixels(message: Any, topic: str) -> UInt8[np.ndarray, "h w 3"] | None:
    """RGB of a sensor_msgs/Image; None where its sizes do not fit its data.

    Raises:
        LogError: an encoding that is not read.
    """
    channels = _CHANNELS.get(message.encoding)
    if channels is None:
        what = f"topic '{topic}' holds images encoded as '{message.encoding}', which are not read"
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
