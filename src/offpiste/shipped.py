"""Trained models that ship with offpiste: run folders inside the package, and the PCA of their features."""

from pathlib import Path
from typing import Final

from offpiste.errors import RunError

PREFIX = "pretrained:"
"""What the name of a model that ships begins with, wherever a run folder or a PCA is expected."""

PCA: Final = "pca.safetensors"
"""File of a family's visual features, beside the folders of its models."""

_FOLDER = Path(__file__).parent / "pretrained_models"


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
        raise RunError(f"no model '{name}' ships", where=str(run), how=f"there are: {', '.join(pretrained_names())}")
    return _FOLDER / name


def pca_file(pca: str | Path) -> Path:
    """File of a PCA, given as a path, or as `pretrained:FAMILY` for that of models that ship.

    Raises:
        RunError: no family of that name ships.
    """
    if not str(pca).startswith(PREFIX):
        return Path(pca)
    name, families = str(pca).removeprefix(PREFIX), sorted(path.parent.name for path in _FOLDER.glob(f"*/{PCA}"))
    if name not in families:
        raise RunError(f"no PCA '{name}' ships", where=str(pca), how=f"there are: {', '.join(families)}")
    return _FOLDER / name / PCA
