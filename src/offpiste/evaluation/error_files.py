"""Files of errors, so that an interrupted evaluation resumes and figures are drawn without predicting again."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from offpiste.errors import RunError
from offpiste.evaluation.errors import Errors
from offpiste.files import write_whole


def save_errors(path: Path, errors: Errors) -> None:
    """Write errors as safetensors, whole or not at all."""
    arrays = {"drive": errors.drive, "row": errors.row, "values": errors.values, "loss": errors.loss}
    contiguous = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    write_whole(path, lambda partial: save_file(contiguous, partial))


def load_errors(path: Path) -> Errors:
    """Read errors that `save_errors` wrote.

    Raises:
        RunError: there is no such file, or it is damaged.
    """
    try:
        return Errors(**load_file(path))
    except (OSError, SafetensorError, TypeError) as error:
        raise RunError(f"cannot be read: {error}", where=path, how="delete it and run again") from error


def saved_errors(path: Path, compute: Callable[[], Errors]) -> Errors:
    """Errors from a file; without one, they are computed and written first.

    Raises:
        RunError: the file is damaged.
    """
    if not path.exists():
        save_errors(path, compute())
    return load_errors(path)
