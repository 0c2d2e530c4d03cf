"""Dataset of a reproduction: simulated and extracted, or given and checked."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from offpiste.core.conventions import DT, FEATURE_SETS
from offpiste.core.errors import DatasetError
from offpiste.core.parallel import at_a_time
from offpiste.dataset.fit_pca import fit_pca
from offpiste.dataset.map_snapshots import SnapshotSettings
from offpiste.dataset.splits import GAP, PARTS, parse_split, write_drives
from offpiste.dataset.store import Dataset, drive_names, open_dataset
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

MIX = {"mojave": 0.64, "halter-ranch": 0.28, "dunes": 0.04, "coastal-scrub": 0.04}
"""Share of the driving time by world (paper, section VI)."""

BLOCKS = "blocks:0.7,0.1,0.2"
"""Split of each log into training, validation and test."""

SHORTEST_CUT = 2 * GAP * DT / 0.1 + 5.0
"""Shortest drive whose validation part holds two windows when it is cut [s]."""


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


def planned_drives(size: Size, *, same_logs: bool = False, contrast: float = 1.0) -> list[PlannedDrive]:
    """Plan all drives, each with its own seed.

    Args:
        same_logs: whether training and test share logs.
        contrast: grip contrast of the worlds.
    """
    seeds = count(size.first_seed)
    driver = WITH_MANOEUVRES if size.manoeuvres else DriverSettings()
    parts = {"": sum(size.seconds)} if same_logs else dict(zip(PARTS, size.seconds, strict=True))
    shortest = max(size.shortest, SHORTEST_CUT) if same_logs else size.shortest
    drives = []
    for part, total in parts.items():
        for preset, seconds in _shared(total, shortest, max(size.longest, shortest)):
            seed = next(seeds)
            world = WorldSettings(preset, seed, contrast, size=size.world_size, resolution=size.world_resolution)
            settings = DriveSettings(world, seconds, seed, sensors=size.sensors, driver=driver)
            drives.append(PlannedDrive(settings, part))
    return drives


def _shared(total: float, shortest: float, longest: float) -> Iterator[tuple[str, float]]:
    """Yield world and length [s] of each drive."""
    for world, share in MIX.items():
        mine = max(share * total, shortest)
        number = max(1, min(math.ceil(mine / longest), math.floor(mine / shortest)))
        yield from [(world, round(mine / number, 2))] * number


def seconds_of(drives: Sequence[PlannedDrive]) -> float:
    """Return the total length of drives [s]."""
    return sum(drive.settings.seconds for drive in drives)


def rig_of(size: Size) -> Rig:
    """Return the rig of the simulated drives."""
    return load_rig("proving_ground_gear" if size.manoeuvres else "proving_ground")


def stored_features(settings: ReproductionSettings) -> int:
    """Return the number of features of the dataset, also before it is made."""
    if settings.dataset is not None:
        return len(open_dataset(settings.dataset).features)
    return min(max(PCA_SWEPT), open_backbone(settings.backbone, device=settings.device).channels)


def driven_seconds(dataset: Dataset) -> tuple[float, float, float]:
    """Return the driving for training, validation and test [s]."""
    train, validation, test = (sum(int((d.part == k).sum()) for d in dataset.drives) for k in range(len(PARTS)))
    return train * DT, validation * DT, test * DT


def opened(settings: ReproductionSettings) -> Dataset:
    """Open the dataset, with windows that start at the speeds of the size."""
    return open_dataset(settings.data).starting_above(settings.size.train.min_speed)


def open_checked(settings: ReproductionSettings) -> Dataset:
    """Open the dataset and check that models can be trained and evaluated on it.

    Raises:
        DatasetError: no dataset, no visual features by distance, a single drive, or too short.
    """
    dataset, train = opened(settings), settings.size.train
    what = how = ""
    if not dataset.features or any(
        d.rows.cells is None or len(d.rows.cells.valid) < len(FEATURE_SETS) for d in dataset.drives
    ):
        what, how = "has no visual features by distance", "extract it with a PCA (`extract --pca`)"
    elif dataset.split.kind == "drives" and len(dataset.drives) < 2:
        what, how = f"holds a single drive, '{dataset.drives[0].name}'", "extract two or more"
    else:
        windows = {part: len(Windows(dataset, part, start=train.start)) for part in PARTS}["train"]
        if windows < train.batch:
            what, how = f"has {windows} training windows, fewer than a batch of {train.batch}", "give longer drives"
    if what:
        raise DatasetError(what, where=dataset.path, how=how)
    return dataset


def data_steps(settings: ReproductionSettings) -> list[Step]:
    """Return the steps that make the dataset; none if it is given."""
    return _SimulatedData(settings).steps() if settings.dataset is None else []


class _SimulatedData:
    """Drives of a reproduction, and the steps that make a dataset of them."""

    def __init__(self, settings: ReproductionSettings) -> None:
        self.settings, self.size = settings, settings.size
        self.drives = planned_drives(self.size, same_logs=settings.split == "blocks", contrast=settings.contrast)
        self.pca = settings.out / "pca.safetensors"
        self.processes = min(at_a_time(settings.processes), len(self.drives))

    def steps(self) -> list[Step]:
        """Return the steps: drives for the PCA, the PCA, and portions of the drives; all in one if logs are kept."""
        of_pca = self._drives_of_pca()
        simulating = Step(
            f"simulate {len(of_pca)} drives, {seconds_of(of_pca) / 60:.0f} min",
            self._cost_of_simulation(of_pca),
            lambda: not self._missing(of_pca),
            lambda: self._simulate(of_pca),
        )
        fitting = Step(
            f"fit the PCA on {self.size.images} images of {len(of_pca)} drives",
            0.5 * seconds_of(of_pca) + 10,
            self.pca.exists,
            lambda: self._fit_pca(of_pca),
        )
        portions = -(-len(self.drives) // (self.size.portion or len(self.drives)))
        return [simulating, fitting, *(self._portion(number, portions) for number in range(1, portions + 1))]

    def _portion(self, number: int, of: int) -> Step:
        """Return the step that simulates and extracts a shard of the drives.

        If logs are not kept, it also extracts the true ground under the wheels, for an oracle, before it removes them.
        """
        mine = sorted(self.drives, key=lambda drive: drive.name)[number - 1 :: of]

        def do() -> None:
            self._simulate(mine)
            processes = min(self.processes, self.settings.at_a_time)
            snapshots = SnapshotSettings(self.size.snapshot_seconds, min_speed=self.size.train.min_speed)
            device = self.settings.device
            self._extract(self.settings.data, (number, of), processes, pca=self.pca, device=device, snapshots=snapshots)
            if self.size.portion:
                self._extract(self.settings.truth, (number, of), self.processes, features="ground-truth")
                for log in map(self._log, mine):
                    log.unlink(missing_ok=True)

        return Step(
            f"simulate and extract {len(mine)} drives" + (f", portion {number} of {of}" if of > 1 else ""),
            self._cost_of_simulation(mine) + 0.6 * seconds_of(mine) / self.processes,
            lambda: {drive.name for drive in mine} <= self._extracted(),
            do,
        )

    def _cost_of_simulation(self, drives: Sequence[PlannedDrive]) -> float:
        return (0.4 * seconds_of(drives) + 8 * len(drives)) / self.processes

    def _log(self, drive: PlannedDrive) -> Path:
        return self.settings.out / "logs" / f"{drive.name}.mcap"

    def _extracted(self) -> set[str]:
        """Return the names of extracted drives; with their true ground if logs are not kept."""
        datasets = [self.settings.data, self.settings.truth] if self.size.portion else [self.settings.data]
        return set.intersection(*(set(drive_names(path)) if path.exists() else set() for path in datasets))

    def _missing(self, drives: Sequence[PlannedDrive]) -> list[PlannedDrive]:
        """Return drives that have neither a log nor rows in the dataset."""
        extracted = self._extracted()
        return [drive for drive in drives if not (drive.name in extracted or self._log(drive).exists())]

    def _simulate(self, drives: Sequence[PlannedDrive]) -> None:
        recordings = [Recording(drive.settings, self._log(drive)) for drive in self._missing(drives)]
        simulate_all(recordings, self.processes, self.settings.cluster)

    def _drives_of_pca(self) -> list[PlannedDrive]:
        """Return the first training drives of each world."""
        by_world: dict[str, list[PlannedDrive]] = {}
        for drive in self.drives:
            if drive.part in ("", "train"):
                by_world.setdefault(drive.settings.world.preset, []).append(drive)
        chosen = [drive for mine in by_world.values() for drive in mine[: self.size.pca_drives]]
        return [drive for drive in self.drives if drive in chosen]

    def _fit_pca(self, drives: Sequence[PlannedDrive]) -> None:
        backbone = open_backbone(self.settings.backbone, device=self.settings.device)
        fitted = fit_pca(
            [self._log(drive) for drive in drives],
            rig_of(self.size),
            parse_split(self._split()),
            backbone,
            images=self.size.images,
            components=min(max(PCA_SWEPT), backbone.channels),
            processes=self.settings.at_a_time,
            cluster=self.settings.cluster,
        )
        save_pca(self.pca, fitted.pca)

    def _extract(self, out: Path, shard: tuple[int, int], processes: int, **options: Any) -> None:
        logs, rig = [self._log(drive) for drive in self.drives], rig_of(self.size)
        options |= {"split": self._split(), "shard": shard, "cluster": self.settings.cluster, "force": True}
        extract(logs, rig, out, processes=processes, **options)

    def _split(self) -> str:
        if self.settings.split == "blocks":
            return BLOCKS
        return write_drives(self.settings.out / "parts.txt", ((drive.name, drive.part) for drive in self.drives))
