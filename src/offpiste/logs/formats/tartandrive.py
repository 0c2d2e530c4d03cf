"""TartanDrive 2.0 folders: per modality a folder with one `.npy` array and `timestamps.txt`."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from offpiste.core.errors import LogError
from offpiste.logs.log import LOG_FORMATS, Log, Samples, Topic, as_log_error
from offpiste.rig.channels import SECONDS_PER_UNIT, Clock

_AGAIN = "export the folder again"


@LOG_FORMATS.register("tartandrive")
class TartanDriveLog(Log):
    """Drive in the post-processed layout of TartanDrive 2.0 (Sivaprakasam et al. 2024).

    Fields are column numbers of the array, "0", "1", ...; a folder without an array has no fields.
    """

    description = "a TartanDrive 2 folder"
    has_clock_unit = True

    def __init__(self, path: Path, *, clock: Clock | None = None) -> None:
        self.path = path
        self._clock = Clock(unit=(clock or Clock()).unit or "s")
        self._topics = {
            stamps.parent.name: _described(stamps.parent) for stamps in sorted(path.glob("*/timestamps.txt"))
        }

    @staticmethod
    def recognises(path: Path) -> bool:
        """Return whether a folder has this layout."""
        # Folders of KITTI have stamps as well, and keep their files in `data`.
        return any(not (stamps.parent / "data").is_dir() for stamps in path.glob("*/timestamps.txt"))

    @property
    def clock(self) -> Clock:
        """Unit of the stamps."""
        return self._clock

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics by name, one per folder."""
        return self._topics

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        folder = self.path / topic.name
        values = _load(folder / topic.type, mapped=False).reshape(topic.count, -1)
        path = folder / "timestamps.txt"
        # An empty file, of which NumPy warns, has no stamps.
        with as_log_error(path, "stamps are not numbers", _AGAIN), warnings.catch_warnings(action="ignore"):
            time = np.loadtxt(path, np.float64, ndmin=1) * SECONDS_PER_UNIT[self._clock.unit]
        if len(time) != len(values):
            how = "the folder was cut short or mixed; export it again"
            raise LogError(f"{len(time)} stamps for {len(values)} samples", where=folder, how=how)
        return Samples(time, values[:, [int(f) for f in fields]].astype(np.float64))


def _described(folder: Path) -> Topic:
    arrays = sorted(folder.glob("*.npy"))
    if not arrays:
        return Topic(folder.name, "folder without array", 0, ())
    array = _load(arrays[0], mapped=True)
    columns = int(np.prod(array.shape[1:], dtype=int))
    return Topic(folder.name, arrays[0].name, len(array), tuple(map(str, range(columns))))


def _load(path: Path, *, mapped: bool) -> np.ndarray:
    with as_log_error(path, "not a readable array", _AGAIN):
        array: np.ndarray = np.load(path, mmap_mode="r" if mapped else None, allow_pickle=False)
    if array.ndim == 0 or array.dtype.kind not in "fiub":
        raise LogError(f"holds {array.dtype}, shape {array.shape}, not rows of numbers", where=path)
    return array
