"""Simulated drives that an experiment needs, made once, several at a time.

Which drives are simulated: the paper's environments in the paper's shares, every drive in a world of its own.

The dataset of a reproduction: simulated, or an existing one that can carry it.
"""

import io
import math
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from offpiste.conventions import DT, FEATURE_SETS
from offpiste.dataset.extract import make_dataset
from offpiste.dataset.fit_pca import fit_pca
from offpiste.dataset.snapshots import SnapshotSettings
from offpiste.dataset.splits import GAP, PARTS, parse_split, write_drives
from offpiste.dataset.store import Dataset, drive_names, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.errors import DatasetError
from offpiste.parallel import Report, run_all, usable_cores
from offpiste.perception.backbones import open_backbone
from offpiste.perception.pca import save_pca
from offpiste.reproduction.pieces import Piece
from offpiste.reproduction.settings import PCA_SWEPT, Reproduction, Size
from offpiste.rig.rig import load_rig
from offpiste.simulation.simulate import DriveSettings, simulate
from offpiste.simulation.world.world import WorldSettings


@dataclass(frozen=True)
class PlannedDrive:
    """A drive to be simulated.

    Attributes:
        part: that it is for; empty where each drive is cut into all of them.
    """

    settings: DriveSettings
    part: str

    @property
    def name(self) -> str:
        """World and seed."""
        return f"{self.settings.world.preset}-{self.settings.seed}"


@dataclass(frozen=True)
class Recording:
    """A drive, and the log that it is recorded to."""

    settings: DriveSettings
    log: Path


def simulate_all(recordings: Sequence[Recording], processes: int) -> None:
    """Record the drives that are not there yet, `processes` at a time.

    Raises:
        OffpisteError: why the first of those failed that did; the others are recorded.
    """
    missing = [recording for recording in recordings if not recording.log.exists()]
    failed = run_all(_record, missing, processes, "simulate")
    if failed:
        raise failed[0]


def simulate_once(settings: DriveSettings, log: Path) -> str:
    """Record a drive unless it is there; what an interruption leaves has another name and is begun again.

    Returns:
        What was driven, for a person.
    """
    if log.exists():
        return f"{log}: there"
    partial = log.with_name(f"{log.stem}.partial{log.suffix}")
    partial.unlink(missing_ok=True)
    driven = simulate(settings, partial)[0]
    partial.rename(log)
    return str(driven).replace(partial.name, log.name)


def _record(recording: Recording, report: Report) -> str:
    with redirect_stderr(io.StringIO()):  # a bar of its own would run into those of others
        return simulate_once(recording.settings, recording.log)


MIX = {"mojave": 0.64, "halter-ranch": 0.28, "dunes": 0.04, "coastal-scrub": 0.04}
"""Shares of the data by environment (paper, section V)."""

BLOCKS = "blocks:0.7,0.1,0.2"
"""How logs are cut where training and test come from the same ones."""

SHORTEST_CUT = 2 * GAP * DT / 0.1 + 5.0
"""A drive that is cut must have a validation stretch of two windows and more [s]."""

FIRST_SEED = 1000


def planned_drives(size: Size, *, same_logs: bool = False, contrast: float = 1.0) -> list[PlannedDrive]:
    """All drives; no two have the same seed.

    Args:
        same_logs: training and test from the same logs.
        contrast: of grip.
    """
    seeds = count(FIRST_SEED)
    parts = {"": sum(size.seconds)} if same_logs else dict(zip(PARTS, size.seconds, strict=True))
    shortest = max(size.shortest, SHORTEST_CUT) if same_logs else size.shortest
    return [
        PlannedDrive(_settings(size, world, next(seeds), seconds, contrast), part)
        for part, total in parts.items()
        for world, seconds in _shared(total, shortest, max(size.longest, shortest))
    ]


def seconds_of(drives: list[PlannedDrive]) -> float:
    """How long they last together [s]."""
    return sum(drive.settings.seconds for drive in drives)


def _shared(total: float, shortest: float, longest: float) -> Iterator[tuple[str, float]]:
    """World and length of each drive [s]."""
    for world, share in MIX.items():
        mine = max(share * total, shortest)
        number = max(1, min(math.ceil(mine / longest), math.floor(mine / shortest)))
        for _ in range(number):
            yield world, round(mine / number, 2)


def _settings(size: Size, world: str, seed: int, seconds: float, contrast: float) -> DriveSettings:
    where = WorldSettings(world, seed, contrast, size=size.world_size, resolution=size.world_resolution)
    return DriveSettings(where, seconds, seed, sensors="light")


RIG = "proving_ground"


def expected_features(asked: Reproduction) -> int:
    """How many features the dataset has, or will have at most."""
    if asked.dataset is not None:
        return len(open_dataset(asked.dataset).features)
    return min(max(PCA_SWEPT), open_backbone(asked.backbone, device=asked.device).channels)


def data_pieces(asked: Reproduction) -> list[Piece]:
    """What leads to a dataset; nothing where one is given."""
    if asked.dataset is not None:
        return []
    drives = planned_drives(asked.size, same_logs=asked.split == "blocks", contrast=asked.contrast)
    pca = asked.out / "pca.safetensors"
    processes = min(asked.processes or usable_cores(), len(drives))
    seconds = seconds_of(drives)
    looked_at = [drive for drive in drives if drive in _of_pca(drives, asked.size.pca_drives)]
    return [
        Piece(
            f"simulate {len(drives)} drives, {seconds / 60:.0f} min",
            (0.4 * seconds + 8 * len(drives)) / processes,
            lambda: all(log.exists() for log in _logs(asked, drives)) or _extracted(asked, drives),
            lambda: _simulate(asked, drives, processes),
        ),
        Piece(
            f"fit the PCA on {asked.size.images} images of {len(looked_at)} drives",
            0.5 * seconds_of(looked_at) + 10,
            pca.exists,
            lambda: _fit(asked, _logs(asked, looked_at), drives, pca),
        ),
        Piece(
            f"extract {len(drives)} drives",
            0.6 * seconds / processes,
            lambda: _extracted(asked, drives),
            lambda: _extract(asked, drives, pca, processes),
        ),
    ]


def open_checked(asked: Reproduction) -> Dataset:
    """The dataset, if models can be trained and judged on it.

    Raises:
        DatasetError: none there, or one without visual features by distance, with one drive, or too short.
    """
    dataset = open_dataset(asked.data)
    cells = [drive.rows.cells for drive in dataset.drives]
    if not dataset.features or any(c is None or len(c.valid) < len(FEATURE_SETS) for c in cells):
        raise DatasetError(
            "has no visual features by distance", where=dataset.path, how="extract it with a PCA (`extract --pca`)"
        )
    if len(dataset.drives) < 2:
        raise DatasetError(
            f"holds one drive, '{dataset.drives[0].name}', which says nothing of others",
            where=dataset.path,
            how="extract two or more",
        )
    count = {part: len(Windows(dataset, part, start=asked.size.train.start)) for part in PARTS}
    if count["train"] < asked.size.train.batch:
        raise DatasetError(
            f"has {count['train']} windows to train, fewer than a batch of {asked.size.train.batch}",
            where=dataset.path,
            how="give longer drives",
        )
    return dataset


def _simulate(asked: Reproduction, drives: list[PlannedDrive], processes: int) -> None:
    recordings = [Recording(d.settings, log) for d, log in zip(drives, _logs(asked, drives), strict=True)]
    simulate_all(recordings, processes)


def _fit(asked: Reproduction, logs: list[Path], drives: list[PlannedDrive], path: Path) -> None:
    backbone = open_backbone(asked.backbone, device=asked.device)
    components = min(max(PCA_SWEPT), backbone.channels)
    split = parse_split(_split(asked, drives))
    fitted = fit_pca(logs, load_rig(RIG), split, backbone, images=asked.size.images, components=components)
    save_pca(path, fitted.pca)


def _extract(asked: Reproduction, drives: list[PlannedDrive], pca: Path, processes: int) -> None:
    make_dataset(
        _logs(asked, drives),
        load_rig(RIG),
        asked.data,
        split=_split(asked, drives),
        pca=pca,
        device=asked.device,
        snapshots=SnapshotSettings(asked.size.snapshot_seconds),
        processes=min(processes, asked.at_a_time),
    )


def _extracted(asked: Reproduction, drives: list[PlannedDrive]) -> bool:
    return asked.data.exists() and {drive.name for drive in drives} <= set(drive_names(asked.data))


def _logs(asked: Reproduction, drives: list[PlannedDrive]) -> list[Path]:
    return [asked.out / "logs" / f"{drive.name}.mcap" for drive in drives]


def _split(asked: Reproduction, drives: list[PlannedDrive]) -> str:
    if asked.split == "blocks":
        return BLOCKS
    return write_drives(asked.out / "parts.txt", ((drive.name, drive.part) for drive in drives))


def _of_pca(drives: list[PlannedDrive], most: int) -> list[PlannedDrive]:
    """The first training drives of each world."""
    found: dict[str, list[PlannedDrive]] = {}
    for drive in drives:
        if drive.part in ("", "train"):
            found.setdefault(drive.settings.world.preset, []).append(drive)
    return [drive for mine in found.values() for drive in mine[:most]]
