"""Dataset of a reproduction: simulated and extracted, or given and checked."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from offpiste.core.conventions import DT, FEATURE_SETS
from offpiste.core.errors import DatasetError
from offpiste.core.parallel import at_a_time
from offpiste.dataset.fit_pca import fit_pca
from offpiste.dataset.map_snapshots import SnapshotSettings
from offpiste.dataset.place import drive_names
from offpiste.dataset.splits import GAP, PARTS, parse_split, write_drives
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.inspection.extract import extract
from offpiste.perception.backbones import open_backbone
from offpiste.perception.pca import save_pca
from offpiste.reproduction.settings import PCA_SWEPT, ReproductionSettings, Size
from offpiste.reproduction.steps import Step
from offpiste.rig.rig import Rig, load_rig
from offpiste.simulation.driver.driver import WITH_MANOEUVRES, DriverSettings
from offpiste.simulation.simulate import DriveSettings, Recording, simulate_all
from offpiste.simulation.world.world import WorldSettings


@dataclass(frozen=True)
class PlannedDrive:
    """Drive to simulate.

    Attributes:
        part: of the split; "" if each drive is cut into all parts.
    """

    settings: DriveSettings
    part: str

    @property
    def name(self) -> str:
        """Name from world and seed."""
        return f"{self.settings.world.preset}-{self.settings.seed}"


MIX = {"mojave": 0.64, "halter-ranch": 0.28, "dunes": 0.04, "coastal-scrub": 0.04}
"""Share of the driving time by world (paper, section VI)."""

BLOCKS = "blocks:0.7,0.1,0.2"
"""Split of each log into training, validation and test."""

SHORTEST_CUT = 2 * GAP * DT / 0.1 + 5.0
"""Shortest drive whose validation part holds two windows when it is cut [s]."""


def planned_drives(size: Size, *, same_logs: bool = False, contrast: float = 1.0) -> list[PlannedDrive]:
    """Plan all drives, each with its own seed.

    Args:
        same_logs: whether training and test share logs.
        contrast: grip contrast of the worlds.
    """
    seeds = count(size.first_seed)
    parts = {"": sum(size.seconds)} if same_logs else dict(zip(PARTS, size.seconds, strict=True))
    shortest = max(size.shortest, SHORTEST_CUT) if same_logs else size.shortest
    return [
        PlannedDrive(_drive_settings(size, world, next(seeds), seconds, contrast), part)
        for part, total in parts.items()
        for world, seconds in _shared(total, shortest, max(size.longest, shortest))
    ]


def seconds_of(drives: list[PlannedDrive]) -> float:
    """Return the total length of drives [s]."""
    return sum(drive.settings.seconds for drive in drives)


def _shared(total: float, shortest: float, longest: float) -> Iterator[tuple[str, float]]:
    """Yield world and length [s] of each drive."""
    for world, share in MIX.items():
        mine = max(share * total, shortest)
        number = max(1, min(math.ceil(mine / longest), math.floor(mine / shortest)))
        for _ in range(number):
            yield world, round(mine / number, 2)


def _drive_settings(size: Size, world: str, seed: int, seconds: float, contrast: float) -> DriveSettings:
    where = WorldSettings(world, seed, contrast, size=size.world_size, resolution=size.world_resolution)
    driver = WITH_MANOEUVRES if size.manoeuvres else DriverSettings()
    return DriveSettings(where, seconds, seed, sensors=size.sensors, driver=driver)


def rig_of(size: Size) -> Rig:
    """Return the rig of the simulated drives."""
    return load_rig("proving_ground_gear" if size.manoeuvres else "proving_ground")


def expected_features(settings: ReproductionSettings) -> int:
    """Return the number of features of the dataset, or an upper bound before it exists."""
    if settings.dataset is not None:
        return len(open_dataset(settings.dataset).features)
    return min(max(PCA_SWEPT), open_backbone(settings.backbone, device=settings.device).channels)


def data_steps(settings: ReproductionSettings) -> list[Step]:
    """Return the steps that make the dataset; none if it is given."""
    if settings.dataset is not None:
        return []
    drives = planned_drives(settings.size, same_logs=settings.split == "blocks", contrast=settings.contrast)
    pca = settings.out / "pca.safetensors"
    pca_drives = [drive for drive in drives if drive in _of_pca(drives, settings.size.pca_drives)]
    fit = Step(
        f"fit the PCA on {settings.size.images} images of {len(pca_drives)} drives",
        0.5 * seconds_of(pca_drives) + 10,
        pca.exists,
        lambda: _fit(settings, _logs(settings, pca_drives), drives, pca),
    )
    if not settings.size.portion:
        return [_simulating(settings, drives), fit, _extracting(settings, drives, pca)]
    portions = -(-len(drives) // settings.size.portion)
    parts = [_portion(settings, drives, pca, number, portions) for number in range(1, portions + 1)]
    return [_simulating(settings, pca_drives), fit, *parts]


def _simulating(settings: ReproductionSettings, drives: list[PlannedDrive]) -> Step:
    return Step(
        f"simulate {len(drives)} drives, {seconds_of(drives) / 60:.0f} min",
        (0.4 * seconds_of(drives) + 8 * len(drives)) / _processes(settings, drives),
        lambda: not _missing(settings, drives),
        lambda: _simulate(settings, drives),
    )


def _extracting(settings: ReproductionSettings, drives: list[PlannedDrive], pca: Path) -> Step:
    return Step(
        f"extract {len(drives)} drives",
        0.6 * seconds_of(drives) / _processes(settings, drives),
        lambda: _extracted(settings, drives),
        lambda: _extract(settings, drives, pca),
    )


def _portion(settings: ReproductionSettings, drives: list[PlannedDrive], pca: Path, number: int, of: int) -> Step:
    """Return the step that simulates and extracts a shard of the drives, with true ground, and removes its logs."""
    mine = sorted(drives, key=lambda drive: drive.name)[number - 1 :: of]

    def do() -> None:
        _simulate(settings, mine)
        _extract(settings, drives, pca, shard=(number, of))
        _extract_truth(settings, drives, shard=(number, of))
        for log in _logs(settings, mine):
            log.unlink(missing_ok=True)

    parts = (_simulating(settings, mine), _extracting(settings, mine, pca))
    name = f"simulate and extract {len(mine)} drives, portion {number} of {of}"
    return Step(name, sum(part.cost for part in parts), lambda: _extracted(settings, mine), do)


def _processes(settings: ReproductionSettings, drives: list[PlannedDrive]) -> int:
    return min(at_a_time(settings.processes), len(drives))


def opened(settings: ReproductionSettings) -> Dataset:
    """Open the dataset, with windows that start at the speeds of the size."""
    return open_dataset(settings.data).starting_above(settings.size.train.min_speed)


def open_checked(settings: ReproductionSettings) -> Dataset:
    """Open the dataset and check that models can be trained and evaluated on it.

    Raises:
        DatasetError: no dataset, no visual features by distance, a single drive, or too short.
    """
    dataset = opened(settings)
    cells = [drive.rows.cells for drive in dataset.drives]
    if not dataset.features or any(c is None or len(c.valid) < len(FEATURE_SETS) for c in cells):
        raise DatasetError(
            "has no visual features by distance", where=dataset.path, how="extract it with a PCA (`extract --pca`)"
        )
    if dataset.split.kind == "drives" and len(dataset.drives) < 2:
        raise DatasetError(
            f"holds a single drive, '{dataset.drives[0].name}'", where=dataset.path, how="extract two or more"
        )
    count = {part: len(Windows(dataset, part, start=settings.size.train.start)) for part in PARTS}
    if count["train"] < settings.size.train.batch:
        raise DatasetError(
            f"has {count['train']} training windows, fewer than a batch of {settings.size.train.batch}",
            where=dataset.path,
            how="give longer drives",
        )
    return dataset


def _missing(settings: ReproductionSettings, drives: list[PlannedDrive]) -> list[PlannedDrive]:
    """Return drives that have neither a log nor rows in the dataset."""
    there = _there(settings)
    return [d for d, log in zip(drives, _logs(settings, drives), strict=True) if not (log.exists() or d.name in there)]


def _simulate(settings: ReproductionSettings, drives: list[PlannedDrive]) -> None:
    missing = _missing(settings, drives)
    recordings = [Recording(d.settings, log) for d, log in zip(missing, _logs(settings, missing), strict=True)]
    simulate_all(recordings, _processes(settings, drives), settings.cluster)


def _fit(settings: ReproductionSettings, logs: list[Path], drives: list[PlannedDrive], path: Path) -> None:
    backbone = open_backbone(settings.backbone, device=settings.device)
    components = min(max(PCA_SWEPT), backbone.channels)
    split = parse_split(_split(settings, drives))
    fitted = fit_pca(
        logs,
        rig_of(settings.size),
        split,
        backbone,
        images=settings.size.images,
        components=components,
        processes=settings.at_a_time,
        cluster=settings.cluster,
    )
    save_pca(path, fitted.pca)


def _extract(
    settings: ReproductionSettings, drives: list[PlannedDrive], pca: Path, shard: tuple[int, int] = (1, 1)
) -> None:
    processes = min(_processes(settings, drives), settings.at_a_time)
    snapshots = SnapshotSettings(settings.size.snapshot_seconds, min_speed=settings.size.train.min_speed)
    options = {"pca": pca, "device": settings.device, "snapshots": snapshots, "processes": processes}
    _make(settings, drives, settings.data, shard, **options)


def _extract_truth(settings: ReproductionSettings, drives: list[PlannedDrive], shard: tuple[int, int]) -> None:
    """Extract the true ground under the wheels, for an oracle, before the logs are removed."""
    processes = _processes(settings, drives)
    _make(settings, drives, settings.truth, shard, features="ground-truth", processes=processes)


def _make(
    settings: ReproductionSettings, drives: list[PlannedDrive], out: Path, shard: tuple[int, int], **options: Any
) -> None:
    logs, split = _logs(settings, drives), _split(settings, drives)
    rig, cluster = rig_of(settings.size), settings.cluster
    extract(logs, rig, out, split=split, shard=shard, cluster=cluster, force=True, **options)


def _extracted(settings: ReproductionSettings, drives: list[PlannedDrive]) -> bool:
    return {drive.name for drive in drives} <= _there(settings)


def _there(settings: ReproductionSettings) -> set[str]:
    """Return the names of extracted drives; with their true ground, if the size keeps it."""
    datasets = [settings.data, settings.truth] if settings.size.portion else [settings.data]
    return set.intersection(*(set(drive_names(path)) if path.exists() else set() for path in datasets))


def _logs(settings: ReproductionSettings, drives: list[PlannedDrive]) -> list[Path]:
    return [settings.out / "logs" / f"{drive.name}.mcap" for drive in drives]


def _split(settings: ReproductionSettings, drives: list[PlannedDrive]) -> str:
    if settings.split == "blocks":
        return BLOCKS
    return write_drives(settings.out / "parts.txt", ((drive.name, drive.part) for drive in drives))


def _of_pca(drives: list[PlannedDrive], most: int) -> list[PlannedDrive]:
    """Return the first training drives of each world."""
    by_world: dict[str, list[PlannedDrive]] = {}
    for drive in drives:
        if drive.part in ("", "train"):
            by_world.setdefault(drive.settings.world.preset, []).append(drive)
    return [drive for mine in by_world.values() for drive in mine[:most]]
