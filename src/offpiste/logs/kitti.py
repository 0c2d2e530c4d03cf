"""KITTI raw drives: a folder `DATE_drive_NUMBER_sync` of images, Velodyne scans and OXTS rows (Geiger et al. 2013)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.errors import LogError
from offpiste.logs.log import Log, Samples, Topic

# fmt: off
_OXTS: Final = (
    "lat", "lon", "alt", "roll", "pitch", "yaw", "vn", "ve", "vf", "vl", "vu", "ax", "ay", "az", "af", "al",
    "au", "wx", "wy", "wz", "wf", "wl", "wu", "pos_accuracy", "vel_accuracy", "navstat", "numsats", "posmode",
    "velmode", "orimode",
)
# fmt: on
"""Columns of an OXTS row (the data set's dataformat.txt)."""
_POSE: Final = ("x", "y", "z", "qx", "qy", "qz", "qw")
_EARTH_RADIUS: Final = 6378137.0
"""Of the devkit's sphere [m]."""


class KittiLog(Log):
    """A drive of KITTI's raw data, synchronised or not.

    Topics: `oxts`, whose fields are its columns and a pose (x, y, z, qx, qy, qz, qw) made of them; and one, without
    fields, for each folder of images (`image_02`) or scans (`velodyne_points`), frames of which may be missing.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._topics = {"oxts": Topic("oxts", "OXTS rows", len(self.files("oxts")), (*_OXTS, *_POSE))}
        for folder in sorted(path.iterdir()):
            if folder.name.startswith(("image_", "velodyne_points")) and (folder / "data").is_dir():
                kind = "images" if folder.name.startswith("image_") else "scans"
                self._topics[folder.name] = Topic(folder.name, kind, len(self.files(folder.name)), ())

    @staticmethod
    def recognises(path: Path) -> bool:
        """Whether a folder has this layout."""
        return (path / "oxts" / "data").is_dir() and (path / "oxts" / "timestamps.txt").is_file()

    @property
    def topics(self) -> dict[str, Topic]:
        """One topic a folder."""
        return self._topics

    def files(self, topic: str) -> dict[int, Path]:
        """Files of a folder by their frame, in order.

        Raises:
            LogError: a file's name is no frame's number.
        """
        files = {}
        for path in sorted((self.path / topic / "data").iterdir()):
            if not path.stem.isdigit():
                raise LogError("its name is no frame's number", where=path, how="remove it")
            files[int(path.stem)] = path
        return files

    def times(self, topic: str, name: str = "timestamps.txt") -> Float[np.ndarray, " n"]:
        """Stamps of all frames of a folder [s since 1970, as if local time were UTC].

        Raises:
            LogError: no such file, or no stamps in it.
        """
        path = self.path / topic / name
        try:
            lines = path.read_text().split("\n")
            stamps = [np.datetime64(line.strip().replace(" ", "T"), "ns") for line in lines if line.strip()]
        except (OSError, ValueError) as error:
            raise LogError(f"no stamps: {error}", where=path, how="download the drive again") from error
        return np.array(stamps, dtype="datetime64[ns]").astype(np.int64) / 10**9

    def frame_times(self, topic: str, name: str = "timestamps.txt") -> Float[np.ndarray, " n"]:
        """Stamps of those frames of a folder that there are files of [s].

        Raises:
            LogError: there are more frames than stamps.
        """
        times, frames = self.times(topic, name), list(self.files(topic))
        if frames and frames[-1] >= len(times):
            what = f"{len(times)} stamps, but a frame {frames[-1]}"
            raise LogError(what, where=self.path / topic, how="the folder was cut short or mixed; download it again")
        return times[frames]

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        if topic.name != "oxts":
            raise LogError(f"topic '{topic.name}' has no numbers", where=self.path)
        rows = np.array([_row(path) for path in self.files("oxts").values()])
        table = np.concatenate((rows, pose_from_oxts(rows)), axis=1)
        names = (*_OXTS, *_POSE)
        return Samples(self.frame_times("oxts"), table[:, [names.index(field) for field in fields]])


def pose_from_oxts(rows: Float[np.ndarray, "n 30"]) -> Float[np.ndarray, "n 7"]:
    """Position and orientation (xyzw) of the OXTS unit: x east, y north, z up, from the first row's place [m].

    Mercator's projection and Euler angles as in the devkit's convertOxtsToPose.m; axes stay level here, where the
    devkit turns everything into the first pose.
    """
    latitude, longitude, altitude, roll, pitch, yaw = rows[:, :6].T
    scale = np.cos(np.deg2rad(latitude[0])) * _EARTH_RADIUS
    east = scale * np.deg2rad(longitude)
    north = scale * np.log(np.tan(np.deg2rad(90 + latitude) / 2))
    position = np.stack((east, north, altitude), axis=1)
    cr, sr, cp, sp, cy, sy = (f(angle / 2) for angle in (roll, pitch, yaw) for f in (np.cos, np.sin))
    orientation = (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
    return np.column_stack((position - position[0], *orientation))


def _row(path: Path) -> Float[np.ndarray, " 30"]:
    try:
        row = np.array(path.read_text().split(), dtype=np.float64)
    except (OSError, ValueError) as error:
        raise LogError(f"not a row of numbers: {error}", where=path, how="download the drive again") from error
    if len(row) != len(_OXTS):
        raise LogError(f"{len(row)} numbers, not {len(_OXTS)}", where=path, how="download the drive again")
    return row
