"""Files of dataclasses whose fields are arrays, numbers and texts."""

from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from offpiste.core.files import write_whole

Record = TypeVar("Record")


def save_arrays(record: Any, path: Path) -> None:
    """Write the fields of a dataclass to an .npz file, whole or not at all."""

    def write(partial: Path) -> None:
        with partial.open("wb") as file:
            np.savez(file, **{field.name: getattr(record, field.name) for field in fields(record)})

    write_whole(path, write)


def load_arrays(kind: type[Record], path: Path) -> Record:
    """Read a dataclass that `save_arrays` wrote."""
    with np.load(path, allow_pickle=False) as stored:
        return kind(**{name: stored[name] if stored[name].ndim else stored[name].item() for name in stored})
