"""Datasets that controls need: their own drives, or other features of the same ones."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from offpiste.dataset.ground_truth import FeatureSource
from offpiste.dataset.hindsight import MIN_HINDSIGHT
from offpiste.dataset.make import make_dataset
from offpiste.dataset.snapshots import SnapshotSettings
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset
from offpiste.experiments.recorded import simulate_once
from offpiste.files import write_text
from offpiste.rig import load_rig
from offpiste.simulation.simulate import DriveSettings
from offpiste.simulation.world import WorldSettings

RIG = "proving_ground"


@dataclass(frozen=True)
class Planned:
    """A drive to be simulated, and the part of the split that it is for."""

    settings: DriveSettings
    part: str

    @property
    def name(self) -> str:
        """World and seed."""
        return f"{self.settings.world.preset}-{self.settings.seed}"


def planned(
    world: str,
    lengths: tuple[Sequence[float], Sequence[float], Sequence[float]],
    *,
    seed: int,
    sensors: str,
    contrast: float = 1.0,
    appearance: float = 1.0,
) -> list[Planned]:
    """Drives on one kind of world, each in a world of its own.

    Args:
        lengths: of the drives that train, validate and test [s].
        seed: of the first drive; the others count on from it.
        contrast, appearance: of `simulation.world.WorldSettings`.
    """
    listed = [(part, seconds) for part, mine in zip(PARTS, lengths, strict=True) for seconds in mine]
    return [
        Planned(
            DriveSettings(WorldSettings(world, seed + k, contrast, appearance), float(seconds), seed + k, sensors), part
        )
        for k, (part, seconds) in enumerate(listed)
    ]


def driven_dataset(
    drives: Sequence[Planned],
    folder: Path,
    *,
    pca: Path | None = None,
    features: FeatureSource = "none",
    snapshot_seconds: float = 0.5,
    min_hindsight: float = MIN_HINDSIGHT,
    tell: Callable[[str], None],
) -> Dataset:
    """Simulate what is missing of some drives and extract them into `folder/dataset.zarr`.

    Args:
        pca: visual features; else `features` of `dataset.ground_truth`.
        snapshot_seconds, min_hindsight: of `dataset.make.make_dataset`.
    """
    logs = [folder / "logs" / f"{drive.name}.mcap" for drive in drives]
    for drive, log in zip(drives, logs, strict=True):
        simulate_once(drive.settings, log, tell=tell)
    parts = folder / "parts.txt"
    write_text(parts, "".join(f"{drive.name} {drive.part}\n" for drive in drives))
    return make_dataset(
        logs,
        load_rig(RIG),
        folder / "dataset.zarr",
        split=f"drives:{parts}",
        pca=pca,
        features=features,
        min_hindsight=min_hindsight,
        snapshots=SnapshotSettings(snapshot_seconds),
        tell=tell,
    )


def oracle_dataset(logs: Sequence[Path], split: str, out: Path, *, tell: Callable[[str], None]) -> Dataset:
    """The true properties of the ground under the wheels of the same drives (`conventions.GROUND_PROPERTIES`)."""
    return make_dataset(logs, load_rig(RIG), out, split=split, features="ground-truth", tell=tell)
