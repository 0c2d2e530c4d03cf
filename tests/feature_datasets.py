"""Small datasets with random visual features by distance."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from factories import circle_rows, small_rig
from offpiste.core.conventions import FEATURE_SETS
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.map_snapshots import SnapshotWriter, crop, open_snapshots
from offpiste.dataset.resample import Rows
from offpiste.dataset.splits import Split, parse_split, write_drives
from offpiste.dataset.store import Dataset, add_drive, create, open_dataset
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.perception.backbones import Backbone
from offpiste.perception.pca import PrincipalComponents
from offpiste.rig.rig import Rig

FEATURES = 5
PARTS = ("train", "train", "validation", "test")
VALID = np.array([1.0, 0.99, 0.99, 0.99, 0.98, 0.9, 0.6, 0.2])


def rows_with_features(rows: int, rng: np.random.Generator, **circle: float) -> Rows:
    """A circle whose cells, three rows long, look different from every distance."""
    driven = circle_rows(rows, seed=int(rng.integers(1000)), **circle)
    index = (4 * (np.arange(rows) // 3)[:, None] + np.arange(4)).astype(np.int32)
    shape = (len(FEATURE_SETS), int(index.max()) + 1)
    look = rng.normal(size=(1, shape[1], FEATURES)) + 0.3 * rng.normal(size=(*shape, FEATURES))
    valid = rng.random(shape) < VALID[:, None]
    away = rng.uniform(1, 40, shape).astype(np.float32)
    look = np.where(valid[..., None], look, np.nan).astype(np.float16)
    normal = np.repeat(driven.normal, len(FEATURE_SETS), axis=0)
    return replace(driven, normal=normal, cells=Cells(index, look, valid, away, np.zeros_like(away)))


def empty_dataset(path: Path, parts: dict[str, str], rig: Rig | None = None) -> Split:
    """A dataset with visual features for drives, each of them in one part; returns its split."""
    split = parse_split(write_drives(path.with_suffix(".txt"), parts.items()))
    create(path, rig or small_rig(), split, tuple(f"pca{k}" for k in range(FEATURES)))
    return split


def random_pca(backbone: Backbone, seed: int = 0, **given: object) -> PrincipalComponents:
    """Four random directions of the features of a backbone."""
    basis = np.linalg.qr(np.random.default_rng(seed).normal(size=(backbone.channels, 4)))[0].astype(np.float32)
    mean, variance = np.zeros(backbone.channels, np.float32), np.ones(4, np.float32)
    about = {"fitted_on": {}} | given
    return PrincipalComponents(mean, basis, variance, 8.0, backbone.name, backbone.fingerprint, **about)


def dataset_with_features(
    path: Path,
    parts: Sequence[str] = PARTS,
    *,
    rows: int = 900,
    seed: int = 0,
    yaw_rate: float = 0.5,
    cells: int = 100,
    speeds: tuple[float, float] = (3.0, 6.0),
) -> Dataset:
    """Some drives, each in one part, with a map of random looks, `cells` of 0.4 m wide."""
    rng, names = np.random.default_rng(seed), [f"circle-{number}" for number in range(len(parts))]
    split = empty_dataset(path, dict(zip(names, parts, strict=True)))
    for name in names:
        driven = rows_with_features(rows, rng, speed=float(rng.uniform(*speeds)), yaw_rate=yaw_rate)
        looks = rng.normal(size=(cells, cells, FEATURES)).astype(np.float32)
        terrain = TerrainMap(driven.origin - 0.2 * cells, 0.4, np.zeros((cells, cells), np.float32), looks)
        add_drive(path, name, driven, split, (), terrain)
    return open_dataset(path)


def with_snapshots(dataset: Dataset, folder: Path, rows: Sequence[int]) -> Dataset:
    """Return the dataset with snapshots of every drive at some rows: slopes with random features."""
    rng, drives = np.random.default_rng(4), []
    for drive in dataset.drives:
        writer = SnapshotWriter(folder / drive.name, 0.4, FEATURES)
        for row in rows:
            looks = rng.normal(size=(300, 300, FEATURES)).astype(np.float32)
            flat = np.ones((300, 300), np.float32)
            rise = np.broadcast_to(np.array([0.1, -0.2], np.float32), (300, 300, 2))
            terrain = TerrainMap(drive.rows.origin - 60.0, 0.4, flat, looks, rise)
            state = drive.rows.state[row] + np.array((*drive.rows.origin, 0, 0, 0, 0))
            writer.add(row, crop(terrain, state, 40.0))
        writer.close()
        drives.append(replace(drive, snapshots=open_snapshots(folder / drive.name)))
    return replace(dataset, drives=tuple(drives))
