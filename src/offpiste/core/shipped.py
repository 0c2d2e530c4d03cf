"""Pretrained models inside the package: run folders and the PCA of their features."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from offpiste.core.errors import RunError, did_you_mean

PREFIX = "pretrained:"
"""Prefix of the name of a pretrained model, in place of a run folder or a PCA file."""

PCA: Final = "pca.safetensors"
"""PCA file beside the run folders of a family of models."""

_FOLDER = Path(__file__).parents[1] / "pretrained_models"


def pretrained_names() -> list[str]:
    """Return the names of pretrained models, such as "proving-ground/dc"."""
    return sorted(path.parent.relative_to(_FOLDER).as_posix() for path in _FOLDER.glob("*/*/model.json"))


def run_folder(run: str | Path) -> Path:
    """Return the folder of a run, given as a path or as `pretrained:NAME`; raises `RunError` for an unknown name."""
    return Path(run) if (name := _shipped(run, "model", pretrained_names())) is None else _FOLDER / name


def named(folder: Path) -> str:
    """Return the name of a run for users: `pretrained:NAME` or its folder."""
    return f"{PREFIX}{folder.relative_to(_FOLDER).as_posix()}" if folder.is_relative_to(_FOLDER) else str(folder)


def names_apart(runs: Sequence[str | Path]) -> list[str]:
    """Return the shortest ends of the paths of runs that differ, as their names."""
    folders = [run_folder(run).absolute().parts for run in runs]
    lengths = range(1, max(map(len, folders), default=1) + 1)
    names = (["/".join(parts[-length:]) for parts in folders] for length in lengths)
    return next(ends for ends in names if len(set(ends)) == len(set(folders)))


def alike(folder: Path) -> str:
    """Suggest a run of similar name beside a folder, or a pretrained one (`errors.did_you_mean`)."""
    beside = [str(path.parent) for path in folder.parent.glob("*/model.json")]
    return did_you_mean(str(folder), [*beside, *(f"{PREFIX}{name}" for name in pretrained_names())])


def pca_file(pca: str | Path) -> Path:
    """Return the file of a PCA, given as a path or as `pretrained:FAMILY`; raises `RunError` for an unknown family."""
    families = sorted(path.parent.name for path in _FOLDER.glob(f"*/{PCA}"))
    return Path(pca) if (name := _shipped(pca, "PCA", families)) is None else _FOLDER / name / PCA


def _shipped(path: str | Path, kind: str, names: Sequence[str]) -> str | None:
    """Return the name of what ships as `pretrained:NAME`; None for a path."""
    if not str(path).startswith(PREFIX):
        return None
    name = str(path).removeprefix(PREFIX)
    if name not in names:
        how = f"{did_you_mean(name, names)}available: {', '.join(names)}"
        raise RunError(f"no pretrained {kind} '{name}'", where=str(path), how=how)
    return name
