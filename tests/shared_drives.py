"""Simulated drives that are recorded once for all workers of a session."""

import fcntl
import hashlib
import os
import shutil
from pathlib import Path

from offpiste.simulation.simulate import DriveSettings, simulate
from offpiste.simulation.world.world import WorldSettings

FOLDER = Path(os.environ["OFFPISTE_TEST_SESSION"])
SMALL_WORLD = WorldSettings("mojave", seed=3, size=60.0, resolution=0.5)
PLAIN = WorldSettings("uniform", size=150.0, resolution=0.5)


def drive_with_sensors(to: Path) -> Path:
    """Write a drive of 2.5 s with one camera and one LiDAR."""
    return _copied(DriveSettings(SMALL_WORLD, 2.5, seed=1, sensors="light"), to)


def blind_drives(folder: Path, count: int = 3, seconds: float = 20.0) -> list[Path]:
    """Write drives without sensors: drive-0.mcap and so on."""
    return [
        _copied(DriveSettings(PLAIN, seconds, seed=seed, sensors="none"), folder / f"drive-{seed}.mcap")
        for seed in range(count)
    ]


def _copied(settings: DriveSettings, to: Path) -> Path:
    kept = FOLDER / f"{hashlib.sha256(repr(settings).encode()).hexdigest()[:20]}.mcap"
    with kept.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not kept.exists():
            simulate(settings, partial := kept.with_suffix(".partial.mcap"))
            partial.rename(kept)
    return Path(shutil.copyfile(kept, to))
