"""KITTI raw drives: folders `DATE_drive_NUMBER_sync` of images, Velodyne scans and OXTS rows (Geiger et al. 2013)."""

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from offpiste.core.errors import LogError
from offpiste.core.limits import read_small
from offpiste.logs.log import LOG_FORMATS, Log, RawCloud, RawImage, Samples, Times, Topic, as_log_error
from offpiste.logs.measurements import decoded_picture
from offpiste.logs.transforms import Transform
from offpiste.rig.camera import CameraModel

_OXTS: Final = (
    *("lat", "lon", "alt", "roll", "pitch", "yaw", "vn", "ve", "vf", "vl", "vu", "ax", "ay", "az", "af", "al", "au"),
    *("wx", "wy", "wz", "wf", "wl", "wu", "pos_accuracy", "vel_accuracy"),
    *("navstat", "numsats", "posmode", "velmode", "orimode"),
)
"""Columns of an OXTS row (dataformat.txt of the dataset)."""
_POSE: Final = ("x", "y", "z", "qx", "qy", "qz", "qw")
_CAMERAS: Final = "calib_cam_to_cam.txt"
_AGAIN: Final = "download the drive again"
_EARTH_RADIUS: Final = 6378137.0
"""Radius of the devkit's sphere [m]."""
POINT: Final = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("time", "<f4")])
"""Record of a point; `time` is relative to the scan's stamp, when the Velodyne faces forward [s]."""


@LOG_FORMATS.register("kitti")
class KittiLog(Log):
    """Drive of KITTI's raw data, synchronised or not; the day's calibration files are in the folder above.

    Topics are `oxts`, with its columns and the pose derived from them (x, y, z, qx, qy, qz, qw) as fields, and each
    folder of images (`image_02`) or scans (`velodyne_points`), without fields and possibly with missing frames. Frames
    are `oxts` (the body), `velodyne_points`, and `image_00` ... `image_03` for rectified images.
    """

    description = "a KITTI raw drive"
    has_sensors = True

    def __init__(self, path: Path) -> None:
        self.path, self._day = path, _day_of(path)
        self._topics = {"oxts": Topic("oxts", "OXTS rows", len(self.files("oxts")), (*_OXTS, *_POSE))}
        for folder in sorted(path.iterdir()):
            if folder.name.startswith(("image_", "velodyne_points")) and (folder / "data").is_dir():
                kind = "images" if folder.name.startswith("image_") else "scans"
                self._topics[folder.name] = Topic(folder.name, kind, len(self.files(folder.name)), ())

    @staticmethod
    def recognises(path: Path) -> bool:
        """Return whether a folder has this layout."""
        return (path / "oxts" / "data").is_dir() and (path / "oxts" / "timestamps.txt").is_file()

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics by name, one per folder."""
        return self._topics

    def files(self, topic: str) -> dict[int, Path]:
        """Return the files of a folder by number, in order."""
        files = {}
        for path in sorted((self.path / topic / "data").iterdir()):
            if not path.stem.isdigit():
                raise LogError("its name is not a frame number", where=path, how="remove it")
            files[int(path.stem)] = path
        return files

    def frame_times(self, topic: str, name: str = "timestamps.txt") -> Float[np.ndarray, " n"]:
        """Return the stamps of existing frames [s since 1970, as if local time were UTC]."""
        path = self.path / topic / name
        # NumPy warns of time zones, which stamps do not have.
        with as_log_error(path, "no stamps", _AGAIN), warnings.catch_warnings(action="error"):
            lines = [line.strip().replace(" ", "T") for line in read_small(path).split("\n") if line.strip()]
            stamps = [np.datetime64(line, "ns") for line in lines]
        times, frames = np.array(stamps, dtype="datetime64[ns]").astype(np.int64) / 10**9, list(self.files(topic))
        if frames and frames[-1] >= len(times):
            what = f"{len(times)} stamps, but a frame {frames[-1]}"
            raise LogError(what, where=self.path / topic, how=f"the folder was cut short or mixed; {_AGAIN}")
        return times[frames]

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        if topic.name != "oxts":
            raise LogError(f"topic '{topic.name}' has no numbers", where=self.path)
        rows = np.array([_row(path) for path in self.files("oxts").values()])
        table = np.concatenate((rows, pose_from_oxts(rows)), axis=1)
        names = (*_OXTS, *_POSE)
        return Samples(self.frame_times("oxts"), table[:, [names.index(field) for field in fields]])

    def transforms(self, topics: Sequence[str]) -> list[Transform]:
        """Return the transforms of calib_imu_to_velo.txt, calib_velo_to_cam.txt and calib_cam_to_cam.txt."""
        velodyne_from_body = _rigid(_calibration(self._day / "calib_imu_to_velo.txt"))
        reference_from_velodyne = _rigid(_calibration(self._day / "calib_velo_to_cam.txt"))
        rectified_from_reference = np.eye(4)
        rectified_from_reference[:3, :3] = _numbers(self._cameras(), "R_rect_00", (3, 3))
        velodyne_from_rectified = np.linalg.inv(rectified_from_reference @ reference_from_velodyne)
        result = [Transform("oxts", "velodyne_points", np.linalg.inv(velodyne_from_body))]
        for name in sorted(self.topics):
            if name.startswith("image_"):
                matrix, baseline = np.split(self._projection(name), (3,), axis=1)
                shift = np.eye(4)
                shift[:3, 3:] = -np.linalg.solve(matrix, baseline)
                result.append(Transform("velodyne_points", name, velodyne_from_rectified @ shift))
        return result

    def camera_model(self, topic: str, *, rectified: bool) -> tuple[CameraModel, Float[np.ndarray, "4 4"]]:
        """Return the calibration of rectified images (P_rect); `transforms` includes their baselines."""
        if not rectified:
            what = f"'{topic}': distorted images of KITTI are not supported"
            raise LogError(what, where=self.path, how="take a _sync drive, and set rectified = true")
        width, height = _numbers(self._cameras(), f"S_rect_{topic[-2:]}", (2,))
        return CameraModel(int(width), int(height), self._projection(topic)[:, :3]), np.eye(4)

    def frame(self, topic: str) -> str:
        """Return the folder's name."""
        return topic

    def stamps(self, topic: str, *, stamps: str = "header") -> Float[np.ndarray, " n"]:
        """Return the stamps of existing frames [s]."""
        return self.frame_times(topic)

    def images(self, topic: str, *, stamps: str = "header", times: Times | None = None) -> Iterator[RawImage]:
        """Yield the images of PNG or JPEG files."""
        for time, path in zip(self.stamps(topic), self.files(topic).values(), strict=True):
            if times is None or time in times:
                yield RawImage(float(time), topic, decoded_picture(np.fromfile(path, np.uint8)))

    def clouds(self, topic: str, *, stamps: str = "header", times: Times | None = None) -> Iterator[RawCloud]:
        """Yield scans (.bin, or .txt in unsynchronised drives) with the time of each point from its azimuth."""
        begins, ends = (self.frame_times(topic, f"timestamps_{edge}.txt") for edge in ("start", "end"))
        files = self.files(topic).values()
        for time, begin, end, path in zip(self.stamps(topic), begins, ends, files, strict=True):
            if times is not None and time not in times:
                continue
            values = _scan(path)
            points = np.zeros(len(values), POINT)
            points["x"], points["y"], points["z"], points["intensity"] = values.T
            points["time"] = time_in_sweep(values[:, :2], begin - time, end - time)
            yield RawCloud(float(time), topic, points)

    def _cameras(self) -> dict[str, Float[np.ndarray, " n"]]:
        return _calibration(self._day / _CAMERAS)

    def _projection(self, topic: str) -> Float[np.ndarray, "3 4"]:
        return _numbers(self._cameras(), f"P_rect_{topic[-2:]}", (3, 4))


@np.errstate(invalid="ignore", divide="ignore")  # latitudes beyond the poles, and infinite ones
def pose_from_oxts(rows: Float[np.ndarray, "n 30"]) -> Float[np.ndarray, "n 7"]:
    """Return the position [m] and orientation (xyzw) of the OXTS unit: x east, y north, z up, from the first position.

    Uses the Mercator projection and Euler angles of the devkit's convertOxtsToPose.m, but keeps the axes level instead
    of expressing all poses in the first one.
    """
    latitude, longitude, altitude, roll, pitch, yaw = rows[:, :6].T
    scale = np.cos(np.deg2rad(latitude[0])) * _EARTH_RADIUS
    east = scale * np.deg2rad(longitude)
    north = scale * np.log(np.tan(np.deg2rad(90 + latitude) / 2))
    position = np.stack((east, north, altitude), axis=1)
    orientation = Rotation.from_euler("ZYX", np.column_stack((yaw, pitch, roll))).as_quat()
    return np.column_stack((position - position[0], orientation))


def _day_of(drive: Path) -> Path:
    """Return the folder with a drive's calibration files, above the drive or above the target of its link."""
    above, linked = drive.absolute().parent, drive.resolve().parent
    return next((day for day in (above, linked) if (day / _CAMERAS).is_file()), linked)


def _row(path: Path) -> Float[np.ndarray, " 30"]:
    with as_log_error(path, "not a row of numbers", _AGAIN):
        row = np.array(read_small(path).split(), dtype=np.float64)
    if len(row) != len(_OXTS):
        raise LogError(f"{len(row)} numbers, not {len(_OXTS)}", where=path, how=_AGAIN)
    return row


def time_in_sweep(xy: Float[np.ndarray, "n 2"], begin: float, end: float) -> Float[np.ndarray, " n"]:
    """Return the time of each point in a revolution from `begin` to `end`, by its azimuth [s].

    The Velodyne turns clockwise, seen from above, starts at the back, and triggers the cameras when it faces forward
    (Geiger et al., IJRR 2013; KISS-ICP uses the same direction, and the tests measure it). Azimuth offsets of single
    lasers, worth a few ms, are unknown.
    """
    turn = (np.pi - np.arctan2(xy[:, 1], xy[:, 0])) / (2 * np.pi)
    return begin + turn * (end - begin)


def _calibration(path: Path) -> dict[str, Float[np.ndarray, " n"]]:
    """Return the numbers of a calibration file by key."""
    how = "put the day's calibration files into the folder above the drive, or above the link to it"
    with as_log_error(path, "no calibration file", how):
        lines = read_small(path).splitlines()
    result = {}
    for line in lines:
        key, _, values = line.partition(":")
        try:
            result[key] = np.array(values.split(), dtype=np.float64)
        except ValueError:  # calib_time
            continue
    return result


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
    with as_log_error(path, "not rows of x, y, z and reflectance", _AGAIN):
        values = np.loadtxt(path, dtype=np.float32, ndmin=2) if path.suffix == ".txt" else np.fromfile(path, "<f4")
        return values.reshape(-1, 4)
