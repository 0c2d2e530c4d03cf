"""A drive on a vehicle: its settings, and the shared memory through which its processes hand on messages."""

import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

from offpiste.core.errors import LiveError
from offpiste.live.reception import CourseRequest
from offpiste.live.ring import Ring
from offpiste.runtime.planner import Planner, load_planner
from offpiste.runtime.settings import RuntimeSettings
from offpiste.transport.interface import RobotSettings
from offpiste.transport.zenoh_transport import ZenohSettings
from offpiste.uncertainty.novelty import Novelty

Source = Literal["system", "clock", "stamps"]
"""The clock that stamps are compared with: the computer's, the one on /clock, or the readings' own stamps."""
_KIB, _MIB = 1 << 10, 1 << 20
RINGS: Final = {
    "readings": (64, 4 * _KIB),
    "images": (8, 32 * _MIB),
    "scans": (4, 64 * _MIB),
    "codes": (8, 16 * _MIB),
    "map": (3, 128 * _MIB),
    "map-state": (4, 1 * _KIB),
    "plans": (8, 64 * _KIB),
    "commands": (512, 1 * _KIB),
    "stops": (4, 64),
    "course": (2, 4 * _MIB),
    "sensors": (2, 1 * _MIB),
    "clock": (4, 64),
    "end": (2, 64),
}
"""Slots, and the largest message [bytes], of each ring; memory is taken only where it is written."""
PARTS: Final = ("receive", "codes", "map", "plan", "control", "watchdog", "record", "view")
"""Processes of a drive; each has a ring for its status beside these."""
_PREFIX: Final = "offpiste-live-"
_LOCK: Final = "lock"
"""File of a session that is locked as long as its owner lives: process numbers mean nothing across containers."""
_BEGINS: Final = 60.0
"""A folder without this file is left alone for so long [s]."""
ROOM: Final = 0.25
"""Shared memory that a drive has to find free [GB]: a process that finds none while it writes is killed."""


@dataclass(frozen=True)
class ViewSettings:
    """How a drive is shown.

    Attributes:
        name: of the viewer, one of `live.viewers.viewer.VIEWERS`.
        place: where it listens (host:port), or what it writes; the viewer's own default if empty.
    """

    name: str
    place: str = ""


@dataclass(frozen=True)
class RecordSettings:
    """How a drive is recorded.

    Attributes:
        path: of the first file (.mcap); the next ones have numbers.
        free: space that stays free on the disk [GB].
        size: of a file, after which a new one begins [GB].
        seconds: length of a file, after which a new one begins [s].
    """

    path: Path
    free: float = 2.0
    size: float = float("inf")
    seconds: float = float("inf")


@dataclass(frozen=True)
class LiveSettings:
    """Settings of a drive on a vehicle (options as in `cli.live.Live`); timeouts and limits are those of the rig."""

    rig: str
    run: str
    pca: Path | None
    course: CourseRequest
    runtime: RuntimeSettings = field(default_factory=RuntimeSettings)
    robot: RobotSettings = field(default_factory=ZenohSettings)
    drive: bool = False
    clock: Source = "system"
    seed: int = 0
    seconds: float = float("inf")
    record: RecordSettings | None = None
    status: Path | None = None
    view: ViewSettings | None = None
    novelty: Novelty = "ignored"

    def load_planner(self, device: str = "cpu") -> Planner:
        """The run, with its features.

        Args:
            device: of the feature extractor; only a process that encodes images wants another than the CPU.

        Raises:
            RunError, PerceptionError: it cannot be loaded (`runtime.planner.load_planner`).
        """
        return load_planner(self.run, self.pca, novelty=self.novelty, device=device)


@dataclass(frozen=True)
class Session:
    """What each process of a drive is given.

    Attributes:
        folder: with the rings.
    """

    settings: LiveSettings
    folder: Path

    def ring(self, name: str) -> Ring:
        """One of `RINGS`, or `status-PART`."""
        return Ring(self.folder / name)


@contextmanager
def new_session(settings: LiveSettings) -> Iterator[Session]:
    """A session whose memory is released at its end; what killed sessions left is removed.

    Raises:
        LiveError: there is no memory for it.
    """
    base = Path("/dev/shm") if Path("/dev/shm").is_dir() else Path(tempfile.gettempdir())
    _remove_left_over(base)
    if (free := shutil.disk_usage(base).free / 1e9) < ROOM:
        how = "make room there; in a container, give it more: --shm-size 1g"
        raise LiveError(f"{free:.2f} GB of shared memory are free, {ROOM:g} are needed", where=base, how=how)
    try:
        folder = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-", dir=base))
    except OSError as error:
        raise LiveError(f"no shared memory: {error.strerror}", where=base, how="make room there") from error
    with (folder / _LOCK).open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            sizes = RINGS | {f"status-{part}": (2, 64 * _KIB) for part in PARTS}
            for name, (slots, size) in sizes.items():
                Ring.create(folder / name, slots=slots, size=size).close()
            yield Session(settings, folder)
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def _remove_left_over(base: Path) -> None:
    for folder in base.glob(f"{_PREFIX}*"):
        with suppress(OSError):  # in use, of another user, or gone meanwhile
            if not (folder / _LOCK).exists():  # another session that begins right now, or what an older version left
                if time.time() - folder.stat().st_mtime < _BEGINS:
                    continue
            else:
                with (folder / _LOCK).open() as lock:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(folder, ignore_errors=True)
