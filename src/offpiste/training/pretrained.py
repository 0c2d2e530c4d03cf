"""Trained models that ship with offpiste: run folders inside the package."""

from pathlib import Path

from offpiste.errors import RunError

PREFIX = "pretrained:"
"""What the name of a model that ships begins with, wherever a run folder is expected."""

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
        raise RunError(f"no model '{name}' ships", where=str(run), how=f"there are: {', '.join(pretrained_names())}")
    return _FOLDER / name
