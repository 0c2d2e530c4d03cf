"""Cameras and LiDARs of a first rig; unknown values are listed in comments."""

import json
import re
from collections.abc import Sequence
from itertools import islice
from typing import Final, Literal

import numpy as np

from offpiste.core.errors import LogError
from offpiste.inspection.draft_pose import first_message
from offpiste.logs.log import Log
from offpiste.logs.measurements import proposed_times, used_bits
from offpiste.logs.ros.image_encodings import pixels_of
from offpiste.logs.transforms import TRANSFORMS, Transform, between
from offpiste.rig.sensors import TIME_FIELDS

BODY = "base_link"
"""Usual name of the body frame (REP 105)."""

LEAST_POINTS = 100
"""Minimum number of points in a scan."""

_FIRST: Final = 10
"""Number of images used to guess the bit depth."""

_IMAGES = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")
_NO_PICTURE = re.compile(r"depth|disparity|mask|label|theora", re.IGNORECASE)
_NO_NAME = re.compile(r"^(image.*|compressed|raw|rect.*|color|rgb|points.*|cloud.*|pointcloud.*|sensors?|data)$", re.I)


def draft_sensors(log: Log, pose_topic: str) -> str:
    """Return TOML of `frames`, `cameras` and `lidars`; comments that begin with MISSING list missing values.

    Args:
        pose_topic: topic whose child frame is the body if no frame has the usual name.

    Returns:
        An empty text if the format or the log has no images and clouds.
    """
    if not log.has_messages:
        return ""
    cameras, lidars = _images(log), _scans(log)
    if not cameras and not lidars:
        return ""
    topics = sorted(name for name, topic in log.topics.items() if topic.type in TRANSFORMS and topic.count)
    fixed = [name for name in topics if name.endswith("static")] or topics
    transforms = log.transforms(fixed)
    body = _body(log, pose_topic, transforms)
    parts = [_frames(body, fixed)]
    taken: set[str] = set()
    for image in cameras:
        parts.append(_camera(log, image, _name(image, taken, "camera"), body, transforms))
    for scan in lidars:
        parts.append(_lidar(log, scan, _name(scan, taken, "lidar"), body, transforms))
    return "\n".join(parts)


def missing(draft: str) -> list[str]:
    """Return the lines of a drafted rig that report missing values."""
    return [line.partition("MISSING: ")[2] for line in draft.splitlines() if "MISSING: " in line]


def _images(log: Log) -> list[str]:
    """Return one image topic per camera, preferring compressed ones, which are usually recorded completely."""
    result: dict[str, str] = {}
    for kind in _IMAGES:
        for name, topic in log.topics.items():
            if topic.type == kind and topic.count and not _NO_PICTURE.search(name):
                result.setdefault(name.removesuffix("/compressed"), name)
    return sorted(result.values())


def _scans(log: Log) -> list[str]:
    names = [n for n, topic in log.topics.items() if topic.type == "sensor_msgs/msg/PointCloud2" and topic.count]
    return sorted(name for name in names if _points(log, name) >= LEAST_POINTS)


def _points(log: Log, name: str) -> int:
    message = first_message(log, name)
    return 0 if message is None else int(message.width) * int(message.height)


def _body(log: Log, pose_topic: str, transforms: Sequence[Transform]) -> str:
    frames = {frame for t in transforms for frame in (t.parent, t.child)}
    if BODY in frames:
        return BODY
    child = str(getattr(first_message(log, pose_topic) if pose_topic in log.topics else None, "child_frame_id", ""))
    return child.lstrip("/") or BODY


def _frames(body: str, topics: Sequence[str]) -> str:
    lines = ["[frames]", f"body = {_toml(body)}  # GUESSED: the frame whose pose the channels are of"]
    if topics:
        lines.append(f"topics = {_toml(list(topics))}")
    else:
        lines.append("# MISSING: transforms: no TF in the log; give body_from_camera and body_from_lidar below")
    return "\n".join([*lines, ""])


def _camera(log: Log, topic: str, name: str, body: str, transforms: list[Transform]) -> str:
    info = _info(log, topic)
    lines = [f"[cameras.{name}]", f"topic = {_toml(topic)}"]
    if info:
        lines.append(f"info = {_toml(info)}")
        rectified = "rect" in topic.lower()
        lines += ["rectified = true         # GUESSED by the topic's name"] if rectified else []
    else:
        lines.append(f"# MISSING: calibration of {name}: no CameraInfo beside {topic}; give cameras.{name}.intrinsics")
    try:
        lines += _bits(log, topic)
    except LogError as error:
        info = ""
        lines.append(f"# MISSING: pictures of {name}: {error.what}")
    lines += _mounting(log, topic, name, body, transforms, "body_from_camera")
    lines += ["# own_body: polygons in the image [px] where the vehicle sees itself", ""]
    # Cameras without calibration or images would be rejected, so they are commented out.
    return "\n".join(lines if info else [line if line.startswith("#") or not line else f"# {line}" for line in lines])


def _bits(log: Log, topic: str) -> list[str]:
    """Return the bit depth of 16-bit images, from the first ones.

    Raises:
        LogError: the topic has no readable images.
    """
    images = [pixels_of(message, topic) for _, message in islice(log.messages(topic), _FIRST)]
    deep = [int(pixels.max()) for pixels in images if pixels is not None and pixels.dtype == np.uint16]
    return [f"bits = {used_bits(max(deep))}                  # GUESSED by the first images"] if deep else []


def _lidar(log: Log, topic: str, name: str, body: str, transforms: list[Transform]) -> str:
    lines = [f"[lidars.{name}]", f"topic = {_toml(topic)}"]
    lines += _mounting(log, topic, name, body, transforms, "body_from_lidar")
    lines += _times(log, topic, name)
    lines += ["# own_body: a box in the body frame [m]; points in it are the vehicle itself", ""]
    return "\n".join(lines)


def _times(log: Log, topic: str, name: str) -> list[str]:
    """Return the settings for a LiDAR's point times, from its first scan."""
    try:
        first, stamps = next(log.clouds(topic)), np.sort(log.stamps(topic))
    except LogError:
        return []
    entries = proposed_times(first, float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0)
    if entries:
        why = "# GUESSED by the first scan: remove these where scans are compensated already"
        return [why, *(f"{key} = {_toml(value)}" for key, value in entries.items())]
    times = [field for field in TIME_FIELDS if field in (first.points.dtype.names or ())]
    what = f"# MISSING: time of the points of {name}: no unit of '{{}}' puts them near the stamp; give time_field and"
    return [what.format(times[0]) + " time_unit, unless scans are compensated already"] if times else []


def _mounting(log: Log, topic: str, name: str, body: str, transforms: list[Transform], key: str) -> list[str]:
    try:
        frame = log.frame(topic)
        between(transforms, body, frame, path=log.path)
    except LogError as error:
        how = "`offpiste inspect LOG --rig THIS --estimate-mountings` estimates it from the guess"
        return [
            f"# MISSING: mounting of {name}: {' '.join(error.what.split())}; {how}, or give {key}",
            f'{key} = {{ looks = "{looks(name)}" }}  # ROUGH GUESS by its name: forward, left, back or right',
        ]
    return [f"# its messages are of frame '{frame}', which the transforms join to '{body}'"]


_SIDES: tuple[tuple[Literal["left", "right", "back"], re.Pattern[str]], ...] = (
    ("left", re.compile(r"(^|_)left(_|$)", re.I)),
    ("right", re.compile(r"(^|_)right(_|$)", re.I)),
    ("back", re.compile(r"(^|_)(back|rear)(_|$)", re.I)),
)


def looks(name: str) -> Literal["forward", "left", "back", "right"]:
    """Return a sensor's viewing direction, guessed from its name; forward by default.

    A name with `front` denotes a forward sensor, even with `left` or `right` of a stereo pair.
    """
    if re.search(r"(^|_)(front|forward|stereo)(_|$)", name, re.I):
        return "forward"
    return next((side for side, pattern in _SIDES if pattern.search(name)), "forward")


def _info(log: Log, image: str) -> str:
    """Return the CameraInfo topic that shares the longest path with an image topic; a single one need not share any."""
    infos = [name for name, topic in log.topics.items() if topic.type == "sensor_msgs/msg/CameraInfo" and topic.count]
    parts = image.strip("/").split("/")

    def shared(info: str) -> int:
        pairs = zip(parts, info.strip("/").split("/"), strict=False)
        return next((k for k, (one, other) in enumerate(pairs) if one != other), len(parts))

    best = max(infos, key=shared, default="")
    return best if best and (shared(best) or len(infos) == 1) else ""


def _name(topic: str, taken: set[str], kind: str) -> str:
    """Return the parts of a topic's path that distinguish a sensor from others."""
    said = [part for part in topic.strip("/").split("/") if not _NO_NAME.match(part)]
    name = re.sub(r"\W+", "_", "_".join(said)) or kind
    number, wanted = 2, name
    while name in taken:
        name, number = f"{wanted}_{number}", number + 1
    taken.add(name)
    return name


def _toml(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)
