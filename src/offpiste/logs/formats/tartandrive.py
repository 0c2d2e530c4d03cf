"""TartanDrive 2.0 folders: per modality a folder with one `.npy` array and `timestamps.txt`."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import LogError
from offpiste.logs.log import LOG_FORMATS, Log, Samples, Topic
from offpiste.rig.channels import SECONDS_PER_UNIT, Clock


@LOG_FORMATS.register("tartandrive")
class TartanDriveLog(Log):
    """Drive in the post-processed layout of TartanDrive 2.0 (Sivaprakasam et al. 2024).

    Fields are column numbers of the array, "0", "1", ...; a folder without an array has no fields.
    """

    description = "a TartanDrive 2 folder"
    has_clock_unit = True

    def __init__(self, path: Path, *, clock: Clock | None = None) -> None:
        self.path = path
        self._clock = clock or Clock()
        self._topics = {
            stamps.parent.name: _described(stamps.parent) for stamps in sorted(path.glob("*/timestamps.txt"))
        }

    @staticmethod
    def recognises(path: Path) -> bool:
        """Return whether a folder has this layout."""
        # Folders of KITTI have stamps as well, and keep their files in `data`.
        return any(not (stamps.parent / "data").is_dir() for stamps in path.glob("*/timestamps.txt"))

    @classmethod
    def open(cls, path: Path, clock: Clock) -> Log:
        """Open a drive whose stamps are in the clock's unit."""
        return cls(path, clock=clock if clock.unit else None)

    @property
    def clock(self) -> Clock:
        """Unit of the stamps."""
        return Clock(unit=self._clock.unit)

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics by name, one per folder."""
        return self._topics

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        folder = self.path / topic.name
        values = _load(folder / topic.type, mapped=False).reshape(topic.count, -1)
        time = _load_stamps(folder / "timestamps.txt") * SECONDS_PER_UNIT[self._clock.unit]
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
    try:
        array: np.ndarray = np.load(path, mmap_mode="r" if mapped else None, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise LogError(f"not a readable array: {error}", where=path, how="export the folder again") from error
    if array.ndim == 0 or array.dtype.kind not in "fiub":
        raise LogError(f"holds {array.dtype}, shape {array.shape}, not rows of numbers", where=path)
    return array


def _load_stamps(path: Path) -> Float[np.ndarray, " n"]:
    try:
        with warnings.catch_warnings(action="ignore"):  # of an empty file, which has no stamps
            return np.loadtxt(path, dtype=np.float64, ndmin=1)
    except (OSError, ValueError) as error:
        raise LogError(f"stamps are not numbers: {error}", where=path, how="export the folder again") from error
