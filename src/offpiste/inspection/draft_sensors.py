"""Cameras and LiDARs of a first rig; unknown values are listed in comments."""

import re
from collections.abc import Sequence
from itertools import count, islice, takewhile
from typing import Final

import numpy as np

from offpiste.core.errors import LogError
from offpiste.inspection.draft_pose import first_message
from offpiste.logs.log import Log
from offpiste.logs.measurements import proposed_times, used_bits
from offpiste.logs.ros.image_encodings import pixels_of
from offpiste.logs.transforms import TRANSFORMS, Transform, between
from offpiste.rig.edits import toml_value
from offpiste.rig.labels import is_named, looks
from offpiste.rig.sensors import TIME_FIELDS

BODY = "base_link"
"""Usual name of the body frame (REP 105)."""
LEAST_POINTS = 100
"""Minimum number of points in a scan."""
_FIRST: Final = 10
"""Number of images used to guess the bit depth."""
_IMAGES = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")
"""Types of images; compressed ones are usually recorded completely."""


def draft_sensors(log: Log, pose_topic: str) -> str:
    """Return TOML of `frames`, `cameras` and `lidars`; comments that begin with MISSING list missing values.

    Args:
        pose_topic: topic whose child frame is the body if no frame has the usual name.

    Returns:
        An empty text if the format or the log has no images and clouds.
    """
    if not log.has_messages:
        return ""
    pictures = [name for kind in _IMAGES for name in _of_type(log, kind) if not is_named("not_pictures", name)]
    by_camera = {name.removesuffix("/compressed"): name for name in reversed(pictures)}
    scans = [name for name in _of_type(log, "sensor_msgs/msg/PointCloud2") if _points(log, name) >= LEAST_POINTS]
    if not pictures and not scans:
        return ""
    topics = sorted(_of_type(log, *TRANSFORMS))
    fixed = [name for name in topics if name.endswith("static")] or topics
    transforms = log.transforms(fixed)
    body = _body(log, pose_topic, transforms)
    lines = ["[frames]", f"body = {toml_value(body)}  # GUESSED: the frame whose pose the channels are of"]
    missing = "# MISSING: transforms: no TF in the log; give body_from_camera and body_from_lidar below"
    lines += [f"topics = {toml_value(fixed)}" if fixed else missing, ""]
    taken: set[str] = set()
    for image in sorted(by_camera.values()):
        name = _name(image, taken, "camera")
        lines += _camera(log, image, name, _mounting(log, image, name, body, transforms, "body_from_camera"))
    for scan in sorted(scans):
        name = _name(scan, taken, "lidar")
        lines += [f"[lidars.{name}]", f"topic = {toml_value(scan)}"]
        lines += _mounting(log, scan, name, body, transforms, "body_from_lidar") + _times(log, scan, name)
        lines += ["# own_body: a box in the body frame [m]; points in it are the vehicle itself", ""]
    return "\n".join(lines)


def missing(draft: str) -> list[str]:
    """Return the lines of a drafted rig that report missing values."""
    return [line.partition("MISSING: ")[2] for line in draft.splitlines() if "MISSING: " in line]


def _of_type(log: Log, *types: str) -> list[str]:
    return [name for name, topic in log.topics.items() if topic.type in types and topic.count]


def _points(log: Log, name: str) -> int:
    message = first_message(log, name)
    return 0 if message is None else int(message.width) * int(message.height)


def _body(log: Log, pose_topic: str, transforms: Sequence[Transform]) -> str:
    if any(BODY in (transform.parent, transform.child) for transform in transforms):
        return BODY
    child = str(getattr(first_message(log, pose_topic) if pose_topic in log.topics else None, "child_frame_id", ""))
    return child.lstrip("/") or BODY


def _camera(log: Log, topic: str, name: str, mounting: list[str]) -> list[str]:
    """Return the lines of a camera, as comments if it lacks its calibration or images and would be rejected."""
    lines = [f"[cameras.{name}]", f"topic = {toml_value(topic)}"]
    if info := _info(log, topic):
        lines.append(f"info = {toml_value(info)}")
        lines += ["rectified = true         # GUESSED by the topic's name"] if "rect" in topic.lower() else []
    else:
        lines.append(f"# MISSING: calibration of {name}: no CameraInfo beside {topic}; give cameras.{name}.intrinsics")
    try:
        lines += _bits(log, topic)
    except LogError as error:
        info = ""
        lines.append(f"# MISSING: pictures of {name}: {error.what}")
    lines += [*mounting, "# own_body: polygons in the image [px] where the vehicle sees itself", ""]
    return lines if info else [line if line.startswith("#") or not line else f"# {line}" for line in lines]


def _bits(log: Log, topic: str) -> list[str]:
    """Return the bit depth of 16-bit images, from the first ones.

    Raises:
        LogError: the topic has no readable images.
    """
    images = [pixels_of(message, topic) for _, message in islice(log.messages(topic), _FIRST)]
    deep = [int(pixels.max()) for pixels in images if pixels is not None and pixels.dtype == np.uint16]
    return [f"bits = {used_bits(max(deep))}                  # GUESSED by the first images"] if deep else []


def _times(log: Log, topic: str, name: str) -> list[str]:
    """Return the settings for a LiDAR's point times, from its first scan."""
    try:
        first, stamps = next(log.clouds(topic)), np.sort(log.stamps(topic))
    except LogError:
        return []
    entries = proposed_times(first, float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0)
    if entries:
        why = "# GUESSED by the first scan: remove these where scans are compensated already"
        return [why, *(f"{key} = {toml_value(value)}" for key, value in entries.items())]
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


def _info(log: Log, image: str) -> str:
    """Return the CameraInfo topic that shares the longest path with an image topic; a single one need not share any."""
    infos = _of_type(log, "sensor_msgs/msg/CameraInfo")

    def shared(info: str) -> int:
        pairs = zip(image.strip("/").split("/"), info.strip("/").split("/"), strict=False)
        return len(list(takewhile(lambda pair: pair[0] == pair[1], pairs)))

    best = max(infos, key=shared, default="")
    return best if best and (shared(best) or len(infos) == 1) else ""


def _name(topic: str, taken: set[str], kind: str) -> str:
    """Return the parts of a topic's path that distinguish a sensor from others."""
    said = [part for part in topic.strip("/").split("/") if not is_named("not_sensor_names", part)]
    wanted = re.sub(r"\W+", "_", "_".join(said)) or kind
    numbered = (f"{wanted}_{number}" if number > 1 else wanted for number in count(1))
    name = next(name for name in numbered if name not in taken)
    taken.add(name)
    return name
