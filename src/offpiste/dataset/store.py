"""Dataset on disk: Zarr v3, one group per drive, written whole or not at all."""

import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import partial as bound
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import zarr
from jaxtyping import Int

from offpiste.core.checksums import CHECKSUMS, check_files, write_checksums
from offpiste.core.conventions import DT, MIN_EVALUATION_SPEED, min_evaluation_speed
from offpiste.core.errors import DatasetError
from offpiste.core.files import check_folder, remove_partials, write_folder
from offpiste.dataset.columns import COLUMNS
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.log_findings import LogFinding, StoredFindings, findings_by_drive
from offpiste.dataset.map_snapshots import Snapshots, SnapshotSettings, open_snapshots
from offpiste.dataset.resample import OWN_COLUMNS, Rows, rows_from_arrays
from offpiste.dataset.splits import Split, stored_split
from offpiste.dataset.store_validation import (
    Settings,
    changed_settings,
    masks_of,
    read_settings,
    refuse_invalid,
    refuse_unlike,
)
from offpiste.dataset.stored_arrays import (
    ARRAYS,
    digest_of_chunks,
    mapped_array,
    open_stored,
    whole_array,
    write_arrays,
)
from offpiste.mapping.replay import MapperSettings
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.rig.rig import Rig

SNAPSHOTS = "snapshots"


@dataclass(frozen=True)
class StoredDrive:
    """One drive of a dataset."""

    name: str
    rows: Rows = field(repr=False)
    part: Int[np.ndarray, " N"] = field(repr=False)
    notes: tuple[str, ...]
    load_map: Callable[[], TerrainMap] | None = None  # reads the map behind the features; None without a map
    snapshots: Snapshots | None = field(default=None, repr=False)  # maps at the start of validation and test windows
    findings: tuple[LogFinding, ...] = ()  # of `inspect` on its log


@dataclass(frozen=True)
class Dataset:
    """All drives of a dataset, in the order of their names."""

    path: Path
    rig: Rig
    split: Split
    drives: tuple[StoredDrive, ...]
    features: tuple[str, ...] = ()  # names of the terrain features under each wheel
    min_hindsight: float = 0.0  # smallest share of a window's ground with features in hindsight
    pca: str | None = None  # identity of the PCA behind visual features (`PrincipalComponents.identity`)
    min_speed: float = MIN_EVALUATION_SPEED  # above which windows start [m/s] (`conventions.min_evaluation_speed`)

    def __repr__(self) -> str:
        minutes = sum(len(drive.rows.time) for drive in self.drives) * DT / 60
        return (
            f"<Dataset {self.path}, rig '{self.rig.name}'\n"
            f"  {len(self.drives)} drives, {minutes:.1f} min, {len(self.features)} features of the ground\n"
            f"  split {self.split.text}>"
        )

    @property
    def findings(self) -> tuple[str, ...]:
        """Findings of `inspect` on the drives in words, each once."""
        return findings_by_drive([(drive.name, drive.findings) for drive in self.drives])

    def starting_above(self, min_speed: float | None) -> "Dataset":
        """Return the dataset with another minimum speed of window starts [m/s]; None keeps it."""
        return self if min_speed is None else replace(self, min_speed=min_speed)

    def relabelled(self, split: Split) -> "Dataset":
        """Return the same rows under another split, without snapshots, which few of its windows would have."""
        parts = [split.label(drive.name, drive.rows.world_xy) for drive in self.drives]
        drives = (replace(d, part=part, snapshots=None) for d, part in zip(self.drives, parts, strict=True))
        return replace(self, split=split, drives=tuple(drives))


def drive_names(path: Path) -> list[str]:
    """Return the names of a dataset's drives."""
    return sorted(f.name for f in path.iterdir() if f.is_dir() and not f.name.startswith("."))


def create(
    path: Path,
    rig: Rig,
    split: Split,
    features: tuple[str, ...] = (),
    pca: str | None = None,
    min_hindsight: float = 0.0,
    snapshots: SnapshotSettings | None = None,
    mapper: MapperSettings | None = None,
) -> None:
    """Begin a dataset, or resume one with the same settings; remains of a killed run are removed.

    Raises `DatasetError` if `path` holds something else, or a dataset with other settings. `snapshots` and `mapper` are
    given for visual features only.
    """
    slowest = min_evaluation_speed(rig.vehicle.wheelbase)
    speed = slowest if snapshots is None or snapshots.min_speed is None else snapshots.min_speed
    settings = Settings(
        made_by=f"offpiste {version('offpiste')}",
        rig=rig,
        split=split.text,
        split_drives=split.drives,
        absent={
            "control": tuple(c.name for c in rig.controls if c.name not in rig.present_controls),
            "actuators": tuple(a.name for a in rig.actuators if a.name not in rig.present_actuators),
        },
        features=features,
        pca=pca,
        min_hindsight=min_hindsight,
        min_speed=slowest,
        masks=masks_of(rig),
        keyframe_metres=None if mapper is None else mapper.keyframe_metres,
        latency=None if snapshots is None else snapshots.latency,
        snapshot_seconds=None if snapshots is None else snapshots.seconds,
        snapshot_speed=None if snapshots is None else speed,
        map_settings=changed_settings(mapper, "keyframe_metres", "threads"),
        snapshot_settings=changed_settings(snapshots, "latency", "seconds", "min_speed"),
    )
    attributes = json.loads(json.dumps(msgspec.to_builtins(settings)))
    check_folder(path)
    begun = path.exists() and any(path.iterdir())
    if begun and not any((path / file).exists() for file in ("zarr.json", CHECKSUMS)):
        raise DatasetError("is a folder without a dataset", where=path, how="give another folder as --out")
    remove_partials(path.parent, path.name)
    if begun:
        stored = read_settings(path)
        if drive_names(path):
            refuse_unlike(path, stored, msgspec.convert(attributes, Settings))
            remove_partials(path)
            return
        shutil.rmtree(path)  # left by a run whose logs all failed

    def write(partial: Path) -> None:
        zarr.open_group(partial, mode="w-", attributes=attributes, zarr_format=3)
        write_checksums(partial, [partial / "zarr.json"])

    write_folder(path, write)


def add_drive(
    path: Path,
    name: str,
    rows: Rows,
    split: Split,
    notes: tuple[str, ...],
    terrain: TerrainMap | None = None,
    snapshots: Path | None = None,
    findings: Sequence[LogFinding] = (),
) -> StoredDrive:
    """Write one drive into a dataset, whole or not at all; raise `DatasetError` if one of this name exists.

    Args:
        terrain: map behind the features; stored if some rows are for validation or test.
        snapshots: folder of a `SnapshotWriter`, which is moved into the dataset.
        findings: of `inspect` on the log.
    """
    if (path / name).exists():
        how = "rename the log: drives are identified by their names"
        raise DatasetError(f"already holds a drive '{name}'", where=path, how=how)
    part = split.label(name, rows.world_xy)
    evaluated = terrain is not None and bool(np.any(part > 0))

    def write(partial: Path) -> None:
        attributes = {"origin": rows.origin.tolist(), "notes": list(notes), "distance_m": rows.distance}
        attributes["findings"] = msgspec.to_builtins(StoredFindings(tuple(findings)))
        group = zarr.open_group(partial, mode="w-", attributes=attributes, zarr_format=3)
        write_arrays(group, {**rows.arrays(), "part": part})
        if rows.cells is not None:
            write_arrays(group.create_group("cells"), {f.name: getattr(rows.cells, f.name) for f in fields(Cells)})
        if terrain is not None and evaluated:
            about = {"origin": terrain.origin.tolist(), "resolution": terrain.resolution}
            layers = group.create_group("map", attributes=about)
            write_arrays(layers, {"elevation": terrain.elevation, "features": terrain.features})
        if snapshots is not None:
            snapshots.replace(partial / SNAPSHOTS)
        # Arrays carry their own checksums; this digest lets a comparison of metadata notice changed arrays.
        group.attrs[ARRAYS] = digest_of_chunks(partial)
        write_checksums(partial, partial.rglob("zarr.json"))

    write_folder(path / name, write)
    load_map = bound(_read_map, path, name) if evaluated else None
    kept = open_snapshots(path / name / SNAPSHOTS) if snapshots is not None else None
    return StoredDrive(name, rows, part, notes, load_map, kept, tuple(findings))


def open_dataset(path: str | Path) -> Dataset:
    """Read a dataset.

    Raises `DatasetError` if there is none, it has another schema or no drives, or a drive is damaged or invalid.
    """
    path = Path(path)
    about, names = read_settings(path), drive_names(path)
    if not names:
        how = "run `offpiste extract` again; it resumes where it stopped"
        raise DatasetError("holds no drive", where=path, how=how)
    split = stored_split(about.split, about.split_drives)
    drives = tuple(_read_drive(path, name) for name in names)
    for drive in drives:
        refuse_invalid(path, drive.name, drive.rows, drive.part, about)
    return Dataset(path, about.rig, split, drives, about.features, about.min_hindsight, about.pca, about.min_speed)


def _read_drive(path: Path, name: str) -> StoredDrive:
    with _reading(path, name):
        check_files(path / name)
        group = open_stored(path / name)
        arrays = {key: whole_array(group, key) for key in ("time", "valid")}
        for key, column in COLUMNS.items():
            if key in OWN_COLUMNS or key in group:  # absent if an extension added the column later
                mapped = column.by_feature_set
                arrays[key] = mapped_array(path / name, group, key) if mapped else whole_array(group, key)
        cells, part = None, whole_array(group, "part")
        if "cells" in group:
            small = {key: whole_array(group, f"cells/{key}") for key in ("index", "valid")}
            large = ("features", "distance", "elevation")
            cells = Cells(**small, **{key: mapped_array(path / name, group, f"cells/{key}") for key in large})
        attributes: dict[str, Any] = dict(group.attrs)
        rows = rows_from_arrays(arrays, np.array(attributes["origin"]), cells)
        load_map = bound(_read_map, path, name) if "map" in group else None
        kept = open_snapshots(path / name / SNAPSHOTS) if SNAPSHOTS in group else None
        found = msgspec.convert(attributes["findings"], StoredFindings).found
        return StoredDrive(name, rows, part, tuple(attributes["notes"]), load_map, kept, found)


def _read_map(path: Path, name: str) -> TerrainMap:
    with _reading(path, name):
        group = open_stored(path / name / "map")
        about: dict[str, Any] = dict(group.attrs)
        layers = whole_array(group, "elevation"), whole_array(group, "features")
        return TerrainMap(np.array(about["origin"]), about["resolution"], *layers)


@contextmanager
def _reading(path: Path, name: str) -> Iterator[None]:
    try:
        yield
    except (OSError, KeyError, ValueError, TypeError, OverflowError, RecursionError) as error:
        what = f"drive '{name}' cannot be read ({type(error).__name__}: {error})"
        raise DatasetError(what, where=path, how=f"delete {path / name} and run `offpiste extract` again") from error
