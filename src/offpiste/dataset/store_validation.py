"""Settings of a stored dataset, which all of its drives share, and checks of arrays that must fit together."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec
import numpy as np
from jaxtyping import Int

from offpiste.core.checksums import CHECKSUMS, DamagedFile, check_files, sha256_of
from offpiste.core.conventions import MIN_EVALUATION_SPEED
from offpiste.core.errors import DatasetError, RigError
from offpiste.core.limits import parsed, read_small
from offpiste.core.object_store import refuse_url
from offpiste.dataset.columns import COLUMNS
from offpiste.dataset.resample import Rows
from offpiste.dataset.splits import PARTS
from offpiste.dataset.stored_arrays import refuse_foreign
from offpiste.rig.rig import Rig, check_rig

SCHEMA: Final = 2

RESTORE: Final = "restore it from a copy, or extract the dataset again"


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """Attributes of a dataset. Drives are added only to a dataset with the same ones, but for `NOTES`."""

    schema: int = SCHEMA
    made_by: str = ""
    rig: Rig
    split: str
    split_drives: tuple[tuple[str, str], ...] = ()
    absent: dict[str, tuple[str, ...]] = {}  # controls and actuators that the rig's logs lack
    features: tuple[str, ...] = ()
    pca: str | None = None
    min_hindsight: float = 0.0
    min_speed: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = MIN_EVALUATION_SPEED
    masks: dict[str, str] = {}  # SHA-256 of each camera's mask
    keyframe_metres: float | None = None  # of visual features, like all that follow
    latency: float | None = None
    snapshot_seconds: float | None = None
    snapshot_speed: float | None = None
    map_settings: dict[str, Any] = {}  # that differ from their defaults
    snapshot_settings: dict[str, Any] = {}


NOTES: Final = ("made_by", "absent", "min_speed")  # settings that follow from others or have no influence


def read_settings(path: Path) -> Settings:
    """Read the settings of a dataset; raise `DatasetError` if there is none, or one is damaged or impossible."""
    refuse_url(path)
    damaged = DatasetError("is damaged", where=path / "zarr.json", how=RESTORE)
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
    if (schema := attributes.get("schema")) != SCHEMA:
        raise DatasetError(f"schema {schema}, this offpiste reads {SCHEMA}", where=path, how="extract it again")
    try:
        settings = msgspec.convert(attributes, type=Settings)
        check_rig(settings.rig)
        if wrong := {part for _, part in settings.split_drives} - set(PARTS):
            raise ValueError(f"'{min(wrong)}' is not a part of a split")
    except (msgspec.ValidationError, RigError, ValueError) as error:
        raise DatasetError(f"cannot be read ({error})", where=path / "zarr.json", how=RESTORE) from error
    return settings


def changed_settings(settings: Any, *excluded: str) -> dict[str, Any]:
    """Return the fields of a dataclass, or of nested ones, that differ from their defaults and are not `excluded`."""
    if settings is None:
        return {}
    default, changed = type(settings)(), dict[str, Any]()
    for name in (field.name for field in fields(settings) if field.name not in excluded):
        value = getattr(settings, name)
        if is_dataclass(value):
            changed |= {f"{name}.{inner}": found for inner, found in changed_settings(value, *excluded).items()}
        elif value != getattr(default, name):
            changed[name] = value
    return changed


def masks_of(rig: Rig) -> dict[str, str]:
    """Return the SHA-256 of each camera's mask; empty for a missing file, which is refused when it is used."""
    files = {name: Path(camera.mask) for name, camera in rig.cameras.items() if camera.mask}
    return {name: sha256_of(file) if file.is_file() else "" for name, file in files.items()}


def refuse_unlike(path: Path, stored: Settings, wanted: Settings) -> None:
    """Raise `DatasetError` for the first setting of the dataset at `path` that differs."""
    stored, wanted = (msgspec.structs.replace(each, rig=_without_mask_files(each.rig)) for each in (stored, wanted))
    for key in Settings.__struct_fields__:
        there, here = getattr(stored, key), getattr(wanted, key)
        if key == "split" and there.startswith("drives:") and here.startswith("drives:"):
            continue  # the parts count, not the file that names them
        if key not in NOTES and there != here:
            long = key in ("rig", "split_drives", "masks")
            both = "" if long else f": it has {_short(there)}, wanted is {_short(here)}"
            what = f"already holds a dataset with another {'mask of a camera' if key == 'masks' else key}{both}"
            raise DatasetError(what, where=path, how="choose another --out, or delete it")


def _without_mask_files(rig: Rig) -> Rig:
    """Return a rig without the files of its masks: their content counts (`masks_of`), wherever they lie."""
    cameras = {name: msgspec.structs.replace(camera, mask="") for name, camera in rig.cameras.items()}
    return msgspec.structs.replace(rig, cameras=cameras)


def _short(value: Any) -> str:
    if isinstance(value, dict):
        value = tuple(f"{name} {one}" for name, one in value.items())
    if not isinstance(value, tuple):
        return "none" if value is None else str(value)
    return ", ".join(map(str, value[:3])) + (f", … ({len(value)})" if len(value) > 3 else "") or "none"


def refuse_invalid(path: Path, name: str, rows: Rows, part: Int[np.ndarray, " N"], about: Settings) -> None:
    """Raise `DatasetError` if arrays of a drive do not fit together, or if rows marked complete are not."""
    for what, good in _claims(rows, part, about):
        if not good:
            how = f"delete {path / name} and run `offpiste extract` again"
            raise DatasetError(f"drive '{name}' cannot be read ({what})", where=path, how=how)


def _claims(rows: Rows, part: Int[np.ndarray, " N"], about: Settings) -> Iterator[tuple[str, bool]]:
    """Yield each possible fault of a drive and whether it is absent; later ones rely on earlier ones."""
    time, count = rows.time, rows.time.size
    yield "'time' is not finite", time.dtype.kind == "f" and bool(np.isfinite(time).all())
    yield "'time' does not rise", time.ndim == 1 and count > 0 and bool((np.diff(time) > 0).all())
    yield "its origin is no position", rows.origin.shape == (2,) and bool(np.isfinite(rows.origin).all())
    columns = dict(COLUMNS.items())
    for key, values in rows.arrays().items():
        column = columns.get(key)
        axis = column.row_axis if column else 0
        fits = values.shape[axis : axis + 1] == (count,) and values.dtype.kind == ("b" if key == "valid" else "f")
        if column:
            shape, present = values.shape[axis + 1 :], column.present(about.rig)
            fits &= len(shape) == len(column.shape) and (shape[-1:] == np.shape(present) or shape == column.shape)
        yield f"'{key}' is {values.dtype} of shape {values.shape}", fits
    yield "'part' holds no parts", part.shape == (count,) and bool(np.isin(part, (-1, 0, 1, 2)).all())
    cells = rows.cells
    yield "it has none of the features that the dataset names", cells is not None or not about.features
    if cells is not None:
        sets, many = cells.valid.shape if cells.valid.ndim == 2 else (-1, -1)
        yield "'cells/index' holds no cell numbers", cells.index.shape == (count, 4) and cells.index.dtype.kind == "i"
        yield "'cells/index' exceeds the cells", bool((cells.index >= -1).all() and (cells.index < many).all())
        yield "'cells/valid' is not boolean", cells.valid.dtype == bool
        for key, more in (("features", (len(about.features),)), ("distance", ()), ("elevation", ())):
            yield f"'cells/{key}' does not fit", getattr(cells, key).shape == (sets, many, *more)
    for key, column in columns.items():
        if not column.by_feature_set:  # those are large, and stay on disk
            broken = np.flatnonzero(rows.valid & ~column.complete(rows.column(key), about.rig))
            first = broken[0] if len(broken) else 0
            what = f"'{key}' is not finite in {len(broken)} rows marked complete, the first is row {first}"
            yield what, not len(broken)
