"""Validation of a dataset's files: it is resumed only as it was begun, and rows marked complete are complete."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from jaxtyping import Int
from msgspec.structs import replace

from offpiste.core.checksums import CHECKSUMS, DamagedFile, check_files, sha256_of
from offpiste.core.conventions import MIN_EVALUATION_SPEED
from offpiste.core.errors import DatasetError, RigError
from offpiste.core.limits import parsed, read_small
from offpiste.dataset.columns import COLUMNS, Column
from offpiste.dataset.resample import Rows
from offpiste.dataset.splits import PARTS
from offpiste.dataset.stored_arrays import refuse_foreign
from offpiste.rig.rig import Rig, check_rig

SCHEMA = 2  # 1 had no checksums, no causal actuators and controls, and straight up for unknown normals

YOUNGER = (
    "masks", "latency", "keyframe_metres", "snapshot_seconds", "snapshot_speed", "map_settings", "snapshot_settings",
)  # fmt: skip
"""Entries of `MADE_BY` that older datasets do not say."""

MADE_BY = ("schema", "rig", "split", "split_drives", "features", "pca", "min_hindsight", *YOUNGER)
"""What all drives of a dataset must share."""


class Settings(msgspec.Struct, frozen=True):
    """What all drives of a dataset share, as its attributes have it (`offpiste.dataset.store.Dataset`)."""

    rig: Rig
    split: str
    split_drives: tuple[tuple[str, str], ...] = ()
    features: tuple[str, ...] = ()
    min_hindsight: float = 0.0
    pca: str | None = None
    min_speed: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = MIN_EVALUATION_SPEED


def changed_settings(settings: Any, *apart: str) -> dict[str, Any]:
    """Fields of settings, those within them included, that are not the defaults; none of None.

    Args:
        settings: a dataclass that has a default for each field.
        apart: names of fields that are left out, at any depth.
    """
    if settings is None:
        return {}
    default, changed = type(settings)(), dict[str, Any]()
    for name in (field.name for field in fields(settings) if field.name not in apart):
        value, usual = getattr(settings, name), getattr(default, name)
        if is_dataclass(value):
            changed |= {f"{name}.{inner}": found for inner, found in changed_settings(value, *apart).items()}
        elif value != usual:
            changed[name] = value
    return changed


def read_settings(attributes: dict[str, Any], path: Path) -> Settings:
    """The settings among a dataset's attributes.

    Raises:
        DatasetError: one is missing, of another type, or impossible.
    """
    try:
        settings = msgspec.convert(attributes, type=Settings)
        check_rig(settings.rig)
        wrong = {part for _, part in settings.split_drives} - set(PARTS)
        if wrong:
            raise ValueError(f"'{min(wrong)}' is no part of a split")
    except (msgspec.ValidationError, RigError, ValueError) as error:
        how = "restore it from a copy, or extract again"
        raise DatasetError(f"cannot be read ({error})", where=path / "zarr.json", how=how) from error
    return settings


def refuse_unlike(path: Path, stored: dict[str, Any], wanted: dict[str, Any]) -> None:
    """Raise if a dataset was begun with other settings.

    Args:
        path: of the dataset.
        stored, wanted: its attributes, as JSON has them.

    Raises:
        DatasetError: names the first attribute that differs, with both values where they are short.
    """
    masks = all("masks" in attributes for attributes in (stored, wanted))
    for key in MADE_BY:
        if key in YOUNGER and not (key in stored and key in wanted):
            continue
        there, here = (_rig_of(a, mask_files=not masks) if key == "rig" else a.get(key) for a in (stored, wanted))
        if key == "split" and all(str(text).startswith("drives:") for text in (there, here)):
            continue  # the parts count, not the file that names them
        if there != here:
            what = {"masks": "mask of a camera"}.get(key, key)
            long = key in ("rig", "split_drives", "masks")
            both = "" if long else f": it has {_short(there)}, wanted is {_short(here)}"
            raise DatasetError(
                f"already holds a dataset with another {what}{both}",
                where=path,
                how="choose another --out, or delete it",
            )


def _rig_of(attributes: dict[str, Any], *, mask_files: bool) -> Any:
    """The rig among a dataset's attributes, with defaults for keys that are younger than the dataset.

    Args:
        mask_files: name the files of masks; otherwise their content counts (`masks_of`), wherever they lie.
    """
    try:
        rig = msgspec.convert(attributes.get("rig"), type=Rig)
    except msgspec.ValidationError:
        return attributes.get("rig")
    cameras = {name: camera if mask_files else replace(camera, mask="") for name, camera in rig.cameras.items()}
    return replace(rig, cameras=cameras)


def masks_of(rig: Rig) -> dict[str, str]:
    """SHA-256 of the masks of a rig's cameras; empty of one that is not there, which is an error where it is used."""
    files = {name: Path(camera.mask) for name, camera in rig.cameras.items() if camera.mask}
    return {name: sha256_of(file) if file.is_file() else "" for name, file in files.items()}


def refuse_invalid(path: Path, name: str, rows: Rows, rig: Rig, *, needs_cells: bool) -> None:
    """Raise if complete rows of a drive are not finite, or if it has no cells where the dataset names features.

    Args:
        path: of the dataset.
        name: of the drive.

    Raises:
        DatasetError: names the drive, the array and the first row.
    """
    how = f"delete {path / name} and run `offpiste extract` again"
    for key, column in COLUMNS.items():
        if column.by_feature_set:  # large, and stays on disk
            continue
        broken = np.flatnonzero(rows.valid & ~column.complete(rows.column(key), rig))
        if len(broken):
            what = f"'{key}' is not finite in {len(broken)} rows that are marked complete, the first is row {broken[0]}"
            raise DatasetError(f"drive '{name}': {what}", where=path, how=how)
    if needs_cells and rows.cells is None:
        raise DatasetError(f"drive '{name}' has none of the features that the dataset names", where=path, how=how)


def refuse_misshapen(path: Path, name: str, rows: Rows, part: Int[np.ndarray, " N"], about: Settings) -> None:
    """Raise if arrays of a drive do not fit together, whatever their checksums say.

    Args:
        path: of the dataset.
        name: of the drive.

    Raises:
        DatasetError: names the drive and the array.
    """
    for what, good in _claims(rows, part, about):
        if not good:
            how = f"delete {path / name} and run `offpiste extract` again"
            raise DatasetError(f"drive '{name}' cannot be read ({what})", where=path, how=how)


def _claims(rows: Rows, part: Int[np.ndarray, " N"], about: Settings) -> Iterator[tuple[str, bool]]:
    """What may be wrong with arrays of a drive, and whether it is not."""
    time, count = rows.time, rows.time.size
    yield "'time' is not finite", time.dtype.kind == "f" and bool(np.isfinite(time).all())
    yield "'time' does not rise", time.ndim == 1 and count > 0 and bool((np.diff(time) > 0).all())
    yield "its origin is no place", rows.origin.shape == (2,) and bool(np.isfinite(rows.origin).all())
    columns = dict(COLUMNS.items())
    for key, values in rows.arrays().items():
        column = columns.get(key)
        axis, kind = (column.row_axis, "f") if column else (0, "b" if key == "valid" else "f")
        fits = values.shape[axis : axis + 1] == (count,) and values.dtype.kind == kind
        fits = fits and (not column or _fits(column, values, about))
        yield f"'{key}' is {values.dtype} of shape {values.shape}", fits
    yield "'part' holds no parts", part.shape == (count,) and bool(np.isin(part, (-1, 0, 1, 2)).all())
    cells = rows.cells
    if cells is not None:
        sets, many = cells.valid.shape if cells.valid.ndim == 2 else (-1, -1)
        yield "'cells/index' is no number of a cell", cells.index.shape == (count, 4) and cells.index.dtype.kind == "i"
        yield "'cells/index' counts beyond the cells", bool((cells.index >= -1).all() and (cells.index < many).all())
        yield "'cells/valid' is not boolean", cells.valid.dtype == bool
        yield "'cells/features' do not fit", cells.features.shape == (sets, many, len(about.features))
        for key in ("distance", "elevation"):
            yield f"'cells/{key}' does not fit", getattr(cells, key).shape == (sets, many)


def _fits(column: Column, values: np.ndarray, about: Settings) -> bool:
    """Whether the components of an array are those of its column."""
    shape = values.shape[column.row_axis + 1 :]
    present = column.present(about.rig)
    return len(shape) == len(column.shape) and (shape[-1:] == np.shape(present) or shape == column.shape)


def _short(value: Any) -> str:
    if isinstance(value, dict):
        value = [f"{name} {one}" for name, one in value.items()]
    if not isinstance(value, list):
        return "none" if value is None else str(value)
    return ", ".join(map(str, value[:3])) + (f", … ({len(value)})" if len(value) > 3 else "") or "none"


def attributes_of(path: Path) -> dict[str, Any]:
    """What a dataset says of how it was made, as JSON has it.

    Raises:
        DatasetError: there is none, or its metadata are damaged.
    """
    damaged = DatasetError("is damaged", where=path / "zarr.json", how="restore it from a copy, or extract again")
    try:
        metadata = parsed(read_small(path / "zarr.json"))
        refuse_foreign(metadata)
        attributes = dict(metadata["attributes"])
        if attributes.get("schema") == SCHEMA:
            check_files(path)
    except DamagedFile as error:
        raise damaged from error
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        if (path / CHECKSUMS).exists():
            raise damaged from error
        raise DatasetError("not a dataset", where=path, how="make one with `offpiste extract`") from error
    return attributes
