"""Cameras and the Velodyne of a KITTI raw drive, with its day's calibration files."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from offpiste.errors import LogError
from offpiste.logs.camera_model import CameraModel
from offpiste.logs.kitti import KittiLog
from offpiste.logs.sensor_source import RawCloud, RawImage, SensorSource, Transform

POINT: Final = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("time", "<f4")])
"""`time` [s] counts from the scan's stamp, when the Velodyne faces ahead."""


class KittiSensors(SensorSource):
    """Frames are `oxts` (the body), `velodyne_points`, and `image_00` ... `image_03` for rectified images."""

    def __init__(self, log: KittiLog) -> None:
        self.log: KittiLog = log
        self._day = log.path.resolve().parent

    def transforms(self, topics: Sequence[str]) -> list[Transform]:
        """Of calib_imu_to_velo.txt, calib_velo_to_cam.txt and calib_cam_to_cam.txt."""
        velodyne_from_body = _rigid(_calibration(self._day / "calib_imu_to_velo.txt"))
        reference_from_velodyne = _rigid(_calibration(self._day / "calib_velo_to_cam.txt"))
        cameras = self._cameras()
        rectified_from_reference = np.eye(4)
        rectified_from_reference[:3, :3] = _numbers(cameras, "R_rect_00", (3, 3))
        velodyne_from_rectified = np.linalg.inv(rectified_from_reference @ reference_from_velodyne)
        found = [Transform("oxts", "velodyne_points", np.linalg.inv(velodyne_from_body))]
        for name in sorted(self.log.topics):
            if name.startswith("image_"):
                matrix, baseline = np.split(self._projection(name), (3,), axis=1)
                shift = np.eye(4)
                shift[:3, 3:] = -np.linalg.solve(matrix, baseline)
                found.append(Transform("velodyne_points", name, velodyne_from_rectified @ shift))
        return found

    def camera_model(self, topic: str, *, rectified: bool) -> tuple[CameraModel, Float[np.ndarray, "4 4"]]:
        """Of the rectified images (P_rect); where they were taken from is in their transforms already."""
        if not rectified:
            what = f"'{topic}': distorted images of KITTI are not read"
            raise LogError(what, where=self.log.path, how="take a _sync drive, and set rectified = true")
        width, height = _numbers(self._cameras(), f"S_rect_{topic[-2:]}", (2,))
        return CameraModel(int(width), int(height), self._projection(topic)[:, :3]), np.eye(4)

    def frame(self, topic: str) -> str:
        """The folder's name."""
        return topic

    def stamps(self, topic: str) -> Float[np.ndarray, " n"]:
        """Of frames that there are files of."""
        return self.log.frame_times(topic)

    def arrivals(self, topic: str) -> None:
        """KITTI does not say."""
        return None

    def images(self, topic: str) -> Iterator[RawImage]:
        """PNG or JPEG files."""
        for time, path in zip(self.stamps(topic), self.log.files(topic).values(), strict=True):
            data = np.fromfile(path, np.uint8)
            decoded = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
            pixels = None if decoded is None else np.asarray(cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB), np.uint8)
            yield RawImage(float(time), topic, pixels)

    def clouds(self, topic: str) -> Iterator[RawCloud]:
        """Scans (.bin, or .txt in unsynchronised drives), each point with its time by its azimuth."""
        begins, ends = (self.log.frame_times(topic, f"timestamps_{edge}.txt") for edge in ("start", "end"))
        files = self.log.files(topic).values()
        for time, begin, end, path in zip(self.stamps(topic), begins, ends, files, strict=True):
            values = _scan(path)
            points = np.zeros(len(values), POINT)
            points["x"], points["y"], points["z"], points["intensity"] = values.T
            points["time"] = time_in_sweep(values[:, :2], begin - time, end - time)
            yield RawCloud(float(time), topic, points)

    def _cameras(self) -> dict[str, Float[np.ndarray, " n"]]:
        return _calibration(self._day / "calib_cam_to_cam.txt")

    def _projection(self, topic: str) -> Float[np.ndarray, "3 4"]:
        return _numbers(self._cameras(), f"P_rect_{topic[-2:]}", (3, 4))


def time_in_sweep(xy: Float[np.ndarray, "n 2"], begin: float, end: float) -> Float[np.ndarray, " n"]:
    """When each point was measured, from its direction alone [s].

    The Velodyne turns clockwise, seen from above, from the back to the back, and triggers the cameras when it faces
    ahead (Geiger et al., IJRR 2013; KISS-ICP takes the same direction, and the tests measure it); begin and end are
    those of the turn. Its lasers point up to some degrees to either side, a few ms that are not known here.
    """
    turn = (np.pi - np.arctan2(xy[:, 1], xy[:, 0])) / (2 * np.pi)
    return begin + turn * (end - begin)


def _calibration(path: Path) -> dict[str, Float[np.ndarray, " n"]]:
    """The numbers of a calibration file by key.

    Raises:
        LogError: no such file.
    """
    try:
        lines = path.read_text().splitlines()
    except OSError as error:
        how = "put the day's calibration files into the folder above the drive"
        raise LogError("no calibration file", where=path, how=how) from error
    found = {}
    for line in lines:
        key, _, values = line.partition(":")
        try:
            found[key] = np.array(values.split(), dtype=np.float64)
        except ValueError:  # calib_time
            continue
    return found


def _numbers(calibration: dict[str, Float[np.ndarray, " n"]], key: str, shape: tuple[int, ...]) -> np.ndarray:
    values = calibration.get(key)
    if values is None or values.size != np.prod(shape):
        raise LogError(f"a KITTI calibration file lacks {key}", how="download the day's calibration again")
    return values.reshape(shape)


def _rigid(calibration: dict[str, Float[np.ndarray, " n"]]) -> Float[np.ndarray, "4 4"]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = _numbers(calibration, "R", (3, 3)), _numbers(calibration, "T", (3,))
    return matrix


def _scan(path: Path) -> Float[np.ndarray, "n 4"]:
    try:
        values = np.loadtxt(path, dtype=np.float32, ndmin=2) if path.suffix == ".txt" else np.fromfile(path, "<f4")
        return values.reshape(-1, 4)
    except (OSError, ValueError) as error:
        raise LogError(f"not rows of x, y, z and reflectance: {error}", where=path, how="download it again") from error
