"""The dataset of a reproduction: simulated, or an existing one that can carry it."""

from collections.abc import Callable
from pathlib import Path

from offpiste.conventions import FEATURE_SETS
from offpiste.dataset.fit_pca import fit_pca
from offpiste.dataset.make import make_dataset
from offpiste.dataset.snapshots import SnapshotSettings
from offpiste.dataset.splits import PARTS, parse_split, write_drives
from offpiste.dataset.store import Dataset, drive_names, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.errors import DatasetError
from offpiste.experiments.recorded import PlannedDrive, Recording, simulate_all
from offpiste.experiments.reproduce.drives import BLOCKS, planned_drives, seconds_of
from offpiste.experiments.reproduce.models import PCA_SWEPT
from offpiste.experiments.reproduce.plan import Piece
from offpiste.experiments.reproduce.settings import Reproduction
from offpiste.parallel import usable_cores
from offpiste.perception.backbone import open_backbone
from offpiste.perception.pca_file import save_pca
from offpiste.rig import load_rig

RIG = "proving_ground"


def expected_features(asked: Reproduction) -> int:
    """How many features the dataset has, or will have at most."""
    if asked.dataset is not None:
        return len(open_dataset(asked.dataset).features)
    return min(max(PCA_SWEPT), open_backbone(asked.backbone, device=asked.device).channels)


def data_pieces(asked: Reproduction, tell: Callable[[str], None]) -> list[Piece]:
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
            lambda: _simulate(asked, drives, processes, tell),
        ),
        Piece(
            f"fit the PCA on {asked.size.images} images of {len(looked_at)} drives",
            0.5 * seconds_of(looked_at) + 10,
            pca.exists,
            lambda: _fit(asked, _logs(asked, looked_at), drives, pca, tell),
        ),
        Piece(
            f"extract {len(drives)} drives",
            0.6 * seconds / processes,
            lambda: _extracted(asked, drives),
            lambda: _extract(asked, drives, pca, processes, tell),
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


def _simulate(asked: Reproduction, drives: list[PlannedDrive], processes: int, tell: Callable[[str], None]) -> None:
    recordings = [Recording(d.settings, log) for d, log in zip(drives, _logs(asked, drives), strict=True)]
    simulate_all(recordings, processes, tell=tell)


def _fit(
    asked: Reproduction, logs: list[Path], drives: list[PlannedDrive], path: Path, tell: Callable[[str], None]
) -> None:
    backbone = open_backbone(asked.backbone, device=asked.device)
    components = min(max(PCA_SWEPT), backbone.channels)
    split = parse_split(_split(asked, drives))
    fitted = fit_pca(logs, load_rig(RIG), split, backbone, images=asked.size.images, components=components, tell=tell)
    save_pca(path, fitted.pca)


def _extract(
    asked: Reproduction, drives: list[PlannedDrive], pca: Path, processes: int, tell: Callable[[str], None]
) -> None:
    make_dataset(
        _logs(asked, drives),
        load_rig(RIG),
        asked.data,
        split=_split(asked, drives),
        pca=pca,
        device=asked.device,
        snapshots=SnapshotSettings(asked.size.snapshot_seconds),
        processes=min(processes, asked.at_a_time),
        tell=tell,
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
