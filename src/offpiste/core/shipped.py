"""Trained models that ship with offpiste: run folders inside the package, and the PCA of their features."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from offpiste.core.errors import RunError, did_you_mean

PREFIX = "pretrained:"
"""What the name of a model that ships begins with, wherever a run folder or a PCA is expected."""

PCA: Final = "pca.safetensors"
"""File of a family's visual features, beside the folders of its models."""

_FOLDER = Path(__file__).parents[1] / "pretrained_models"


def pretrained_names() -> list[str]:
    """Names of the models that ship: "proving-ground/dc" and others."""
    return sorted(path.parent.relative_to(_FOLDER).as_posix() for path in _FOLDER.glob("*/*/model.json"))


def run_folder(run: str | Path) -> Path:
    """Folder of a run, given as a path, or as `pretrained:NAME` for a model that ships.

    Raises:
        RunError: no model of that name ships.
    """
    if not str(run).startswith(PREFIX):
        return Path(run)
    name = str(run).removeprefix(PREFIX)
    if name not in pretrained_names():
        how = f"{did_you_mean(name, pretrained_names())}there are: {', '.join(pretrained_names())}"
        raise RunError(f"no model '{name}' ships", where=str(run), how=how)
    return _FOLDER / name


def named(folder: Path) -> str:
    """How a person names a run: `pretrained:NAME` for a model that ships, else its folder."""
    return f"{PREFIX}{folder.relative_to(_FOLDER).as_posix()}" if folder.is_relative_to(_FOLDER) else str(folder)


def names_apart(runs: Sequence[str | Path]) -> list[str]:
    """Names of runs, given as to `run_folder`: the ends of their paths, as long as it takes for them to differ."""
    folders = [run_folder(run).absolute().parts for run in runs]
    lengths = range(1, max(map(len, folders), default=1) + 1)
    names = (["/".join(parts[-length:]) for parts in folders] for length in lengths)
    return next(ends for ends in names if len(set(ends)) == len(set(folders)))


def alike(folder: Path) -> str:
    """A question that names a run of nearly this name beside it, or one that ships (`errors.did_you_mean`)."""
    beside = [str(path.parent) for path in folder.parent.glob("*/model.json")]
    return did_you_mean(str(folder), [*beside, *(f"{PREFIX}{name}" for name in pretrained_names())])


def pca_file(pca: str | Path) -> Path:
    """File of a PCA, given as a path, or as `pretrained:FAMILY` for that of models that ship.

    Raises:
        RunError: no family of that name ships.
    """
    if not str(pca).startswith(PREFIX):
        return Path(pca)
    name, families = str(pca).removeprefix(PREFIX), sorted(path.parent.name for path in _FOLDER.glob(f"*/{PCA}"))
    if name not in families:
        how = f"{did_you_mean(name, families)}there are: {', '.join(families)}"
        raise RunError(f"no PCA '{name}' ships", where=str(pca), how=how)
    return _FOLDER / name / PCA
