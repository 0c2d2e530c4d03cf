"""Datasets that controls need: their own drives, or other features of the same ones."""

import json
import logging
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from experiments.control_experiments.reproduced import Reproduced
from offpiste.dataset.extract import make_dataset
from offpiste.dataset.ground_truth_features import FeatureSource
from offpiste.dataset.map_snapshots import SnapshotSettings
from offpiste.dataset.splits import PARTS, write_drives
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.dataset.window_starts import MIN_HINDSIGHT
from offpiste.errors import RunError
from offpiste.reproduction.data import PlannedDrive
from offpiste.reproduction.steps import claim_folder
from offpiste.rig.rig import Rig, load_rig
from offpiste.simulation.recordings import simulate_once
from offpiste.simulation.simulate import DriveSettings
from offpiste.simulation.world.world import WorldSettings
from offpiste.training.checkpoint import load_json, save_json

logger = logging.getLogger("experiments")

RIG = "proving_ground"
ELSEWHERE = "give the same again, or choose another --out"


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
        contrast, appearance: of `simulation.world.world.WorldSettings`.
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
    rig: Rig | None = None,
) -> Dataset:
    """Simulate what is missing of some drives and extract them into `folder/dataset.zarr`.

    Args:
        pca: visual features; else `features` of `dataset.ground_truth_features`.
        snapshot_seconds, min_hindsight: of `dataset.extract.make_dataset`.
        rig: of the drives; None: the proving ground's.

    Raises:
        RunError: the folder has one of the drives with other settings.
    """
    claim_drives(folder, drives)
    logs = [folder / "logs" / f"{drive.name}.mcap" for drive in drives]
    for drive, log in zip(drives, logs, strict=True):
        logger.info(simulate_once(drive.settings, log))
    return make_dataset(
        logs,
        rig or load_rig(RIG),
        folder / "dataset.zarr",
        split=write_drives(folder / "parts.txt", ((drive.name, drive.part) for drive in drives)),
        pca=pca,
        features=features,
        min_hindsight=min_hindsight,
        snapshots=SnapshotSettings(snapshot_seconds),
        force=True,
    )


def claim_drives(folder: Path, drives: Sequence[PlannedDrive]) -> None:
    """Record settings and parts of drives in `folder/drives.json`, or check that they are the same: logs are reused.

    Raises:
        RunError: a drive of that name has others.
    """
    path = folder / "drives.json"
    wanted = {drive.name: _flat({"part": drive.part, **asdict(drive.settings)}) for drive in drives}
    before: dict[str, dict[str, Any]] = load_json(path) if path.exists() else _older(folder)
    for name, mine in wanted.items():
        there = before.get(name, {})
        if other := [key for key, value in mine.items() if there.get(key, value) != value]:
            what = f"drive '{name}' was made with other settings ({', '.join(other)})"
            raise RunError(what, where=folder, how=ELSEWHERE)
    folder.mkdir(parents=True, exist_ok=True)
    save_json(path, before | wanted)


def _older(folder: Path) -> dict[str, dict[str, Any]]:
    """Parts of the drives of a folder from before there was a `drives.json`."""
    parts = folder / "parts.txt"
    if not parts.exists():
        return {}
    logger.warning(
        f"{folder}: does not say how its drives were made, since an older version made them: they are reused"
    )
    return {name: {"part": part} for name, part in map(str.split, parts.read_text("utf-8").splitlines())}


def _flat(settings: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Settings by dotted names, as JSON reads them back."""
    result: dict[str, Any] = {}
    for key, value in settings.items():
        if isinstance(value, dict):
            result |= _flat(value, f"{prefix}{key}.")
        else:
            result[prefix + key] = json.loads(json.dumps(value))
    return result


def claim_settings(folder: Path, settings: dict[str, Any]) -> None:
    """`claim_folder` of one experiment's folder; one from before experiments did so is reused with a warning.

    Raises:
        RunError: it was begun with other settings.
    """
    if (folder / "control.json").exists() and not (folder / "settings.json").exists():
        logger.warning(f"{folder}: does not say what it was made with, since an older version made it: it is reused")
    claim_folder(folder, settings)


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
