"""Datasets that controls need: their own drives, or other features of the same ones."""

import logging
from collections.abc import Sequence
from pathlib import Path

from experiments.control_experiments.reproduced import Reproduced
from offpiste.dataset.extract import make_dataset
from offpiste.dataset.ground_truth_features import FeatureSource
from offpiste.dataset.map_snapshots import SnapshotSettings
from offpiste.dataset.splits import PARTS, write_drives
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.dataset.window_starts import MIN_HINDSIGHT
from offpiste.reproduction.data import PlannedDrive
from offpiste.rig.rig import Rig, load_rig
from offpiste.simulation.recordings import simulate_once
from offpiste.simulation.simulate import DriveSettings
from offpiste.simulation.world.world import WorldSettings

logger = logging.getLogger("experiments")

RIG = "proving_ground"


def planned(
    world: str,
    lengths: tuple[Sequence[float], Sequence[float], Sequence[float]],
    *,
    seed: int,
    sensors: str,
    contrast: float = 1.0,
    appearance: float = 1.0,
) -> list[PlannedDrive]:
    """Drives on one kind of world, each in a world of its own.

    Args:
        lengths: of the drives that train, validate and test [s].
        seed: of the first drive; the others count on from it.
        contrast, appearance: of `simulation.world.WorldSettings`.
    """
    listed = [(part, seconds) for part, mine in zip(PARTS, lengths, strict=True) for seconds in mine]
    return [
        PlannedDrive(
            DriveSettings(WorldSettings(world, seed + k, contrast, appearance), float(seconds), seed + k, sensors), part
        )
        for k, (part, seconds) in enumerate(listed)
    ]


def driven_dataset(
    drives: Sequence[PlannedDrive],
    folder: Path,
    *,
    pca: Path | None = None,
    features: FeatureSource = "none",
    snapshot_seconds: float = 0.5,
    min_hindsight: float = MIN_HINDSIGHT,
) -> Dataset:
    """Simulate what is missing of some drives and extract them into `folder/dataset.zarr`.

    Args:
        pca: visual features; else `features` of `dataset.ground_truth_features`.
        snapshot_seconds, min_hindsight: of `dataset.make.make_dataset`.
    """
    logs = [folder / "logs" / f"{drive.name}.mcap" for drive in drives]
    for drive, log in zip(drives, logs, strict=True):
        logger.info(simulate_once(drive.settings, log))
    return make_dataset(
        logs,
        load_rig(RIG),
        folder / "dataset.zarr",
        split=write_drives(folder / "parts.txt", ((drive.name, drive.part) for drive in drives)),
        pca=pca,
        features=features,
        min_hindsight=min_hindsight,
        snapshots=SnapshotSettings(snapshot_seconds),
        force=True,
    )


def oracle_dataset(logs: Sequence[Path], split: str, out: Path, rig: Rig | None = None) -> Dataset:
    """The true properties of the ground under the wheels of the same drives (`logs.ground_truth.GROUND_PROPERTIES`)."""
    return make_dataset(logs, rig or load_rig(RIG), out, split=split, features="ground-truth", force=True)


def true_ground(of: Reproduced, folder: Path) -> Dataset:
    """The same of a reproduction's drives.

    Args:
        folder: where they are extracted to if the reproduction does not keep them.
    """
    if of.kept_truth.exists():
        truth = open_dataset(of.kept_truth)
    else:
        truth = oracle_dataset(of.logs(), of.split_for(folder), folder / "dataset.zarr", of.dataset.rig)
    return truth.starting_above(of.size.train.min_speed)
