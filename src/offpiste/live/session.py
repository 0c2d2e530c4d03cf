"""A drive on a vehicle: settings, topics, the checks of its model, and the shared memory of its processes."""

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

from offpiste.core.channels import all_actuators
from offpiste.core.errors import LiveError
from offpiste.live.reception import CourseRequest
from offpiste.live.ring import Ring
from offpiste.rig.rig import Rig
from offpiste.runtime.planner import Planner, load_planner
from offpiste.runtime.settings import RuntimeSettings
from offpiste.transport.zenoh_transport import ZenohSettings
from offpiste.uncertainty.novelty import Novelty

CLOCK: Final = "/clock"
COMMAND: Final = "/offpiste/command"
"""Every command, sent to the vehicle or not (sensor_msgs/Joy): throttle, brake, steer."""
MODE: Final = "/offpiste/mode"
"""Mode and its reason, at each change (std_msgs/String)."""
PLAN: Final = "/offpiste/plan"
"""Predicted path of the plan (nav_msgs/Path)."""
MAP: Final = "/offpiste/map"
"""The map (grid_map_msgs/GridMap)."""
DIAGNOSTICS: Final = "/diagnostics"
"""State of each process (diagnostic_msgs/DiagnosticArray)."""

Source = Literal["system", "clock", "stamps"]
"""Clock that stamps are compared with: the computer's, /clock, or the stamps of the readings."""
PARTS: Final = {
    "receive": "receive.receive",
    "codes": "map_and_plan.codes",
    "map": "map_and_plan.map_ground",
    "plan": "map_and_plan.plan",
    "control": "control.control",
    "watchdog": "control.watchdog",
    "record": "record.record",
    "view": "view.view",
}
"""Processes of a drive, with the module and function that each runs."""
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
} | {f"status-{part}": (2, 64 * _KIB) for part in PARTS}
"""Number of slots and maximum message size [bytes] of each ring; memory is allocated when it is written."""
_PREFIX: Final = "offpiste-live-"
_LOCK: Final = "lock"
"""File that a session's owner keeps locked: process numbers mean nothing across containers."""
_BEGINS: Final = 60.0
"""Minimum age of a folder without the lock file before it is removed [s]."""
ROOM: Final = 0.25
"""Minimum free shared memory [GB]: a process that writes to full memory is killed."""


@dataclass(frozen=True)
class RecordSettings:
    """Recording of a drive."""

    path: Path  # of the first file (.mcap); later ones are numbered
    free: float = 2.0  # disk space that must remain free [GB]
    size: float = float("inf")  # of a file [GB]
    seconds: float = float("inf")  # duration of a file


@dataclass(frozen=True)
class LiveSettings:
    """Settings of a drive on a vehicle (options as in `cli.live.Live`); the rig has the timeouts and limits."""

    rig: str
    run: str
    pca: Path | None
    course: CourseRequest
    runtime: RuntimeSettings = field(default_factory=RuntimeSettings)
    robot: ZenohSettings = field(default_factory=ZenohSettings)
    drive: bool = False
    clock: Source = "system"
    seed: int = 0
    seconds: float = float("inf")
    record: RecordSettings | None = None
    cameras: bool = False  # whether the model reads images
    view: str = ""
    view_at: str = ""
    novelty: Novelty = "ignored"

    def load_planner(self, device: str = "cpu") -> Planner:
        """Load the run, with its feature extractor on a device; only the process that encodes images needs a GPU."""
        return load_planner(self.run, self.pca, novelty=self.novelty, device=device)


def refuse_unmeasured(planner: Planner, rig: Rig) -> None:
    """Raise `LiveError` for a model whose inputs the robot lacks: true ground, actuators, or images."""
    if planner.knows_ground:
        how = "give a run trained on visual features, or on none"
        raise LiveError("reads the ground's true properties, which no robot has", where=planner.folder, how=how)
    lacks = [name for name in planner.dynamics.vehicle.actuators if name not in rig.present_actuators]
    if lacks:
        known = {actuator.name: actuator for actuator in all_actuators()}
        needed = dict.fromkeys(known[known[name].rate_of or name].channel for name in lacks)
        how = f"add {', '.join(f'[channels.{name}]' for name in needed)} to the rig, or give a run trained without them"
        what = f"the model reads {', '.join(lacks)}, which rig '{rig.name}' does not have"
        raise LiveError(what, where=planner.folder, how=how)
    if planner.extractor is not None and not rig.cameras:
        how = "add its cameras to the rig, or give a run that reads no images"
        raise LiveError(f"the model reads images, and rig '{rig.name}' has no cameras", where=planner.folder, how=how)


@dataclass(frozen=True)
class Session:
    """Settings of a drive, and the folder of its rings."""

    settings: LiveSettings
    folder: Path

    def ring(self, name: str) -> Ring:
        """Open one of `RINGS`."""
        return Ring(self.folder / name)


@contextmanager
def new_session(settings: LiveSettings) -> Iterator[Session]:
    """Create a session, whose memory is released at its end; remove the memory of killed sessions.

    Raises:
        LiveError: memory is insufficient.
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
            for name, (slots, size) in RINGS.items():
                Ring.create(folder / name, slots=slots, size=size).close()
            yield Session(settings, folder)
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def _remove_left_over(base: Path) -> None:
    for folder in base.glob(f"{_PREFIX}*"):
        with suppress(OSError):  # in use, of another user, or removed meanwhile
            if not (folder / _LOCK).exists():  # another session that begins right now, or was killed while it began
                if time.time() - folder.stat().st_mtime < _BEGINS:
                    continue
            else:
                with (folder / _LOCK).open() as lock:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(folder, ignore_errors=True)
