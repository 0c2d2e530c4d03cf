"""Validation of a dataset's files: it is resumed only as it was begun, and rows marked complete are complete."""

from pathlib import Path
from typing import Any

import numpy as np

from offpiste.dataset.columns import COLUMNS
from offpiste.dataset.resample import Rows
from offpiste.errors import DatasetError
from offpiste.rig.rig import Rig

MADE_BY = ("schema", "rig", "split", "split_drives", "features", "pca", "min_hindsight", "latency")
"""What all drives of a dataset must share."""


def refuse_unlike(path: Path, stored: dict[str, Any], wanted: dict[str, Any]) -> None:
    """Raise if a dataset was begun with other settings.

    Args:
        path: of the dataset.
        stored, wanted: its attributes, as JSON has them.

    Raises:
        DatasetError: names the first attribute that differs, with both values where they are short.
    """
    for key in MADE_BY:
        there, here = stored.get(key), wanted[key]
        if key == "split" and all(str(text).startswith("drives:") for text in (there, here)):
            continue  # the parts count, not the file that names them
        if there != here:
            both = "" if key in ("rig", "split_drives") else f": it has {_short(there)}, wanted is {_short(here)}"
            raise DatasetError(
                f"already holds a dataset with another {key}{both}",
                where=path,
                how="choose another --out, or delete it",
            )


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


def _short(value: Any) -> str:
    if not isinstance(value, list):
        return "none" if value is None else str(value)
    return ", ".join(map(str, value[:3])) + (f", … ({len(value)})" if len(value) > 3 else "") or "none"
