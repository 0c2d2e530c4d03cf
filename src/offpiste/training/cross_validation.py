"""Blocked cross-validation: every stretch of every drive is tested once, and everything fitted is fitted anew."""

import logging
from pathlib import Path

from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import Dataset
from offpiste.errors import RunError
from offpiste.training.config import TrainConfig
from offpiste.training.train import train

logger = logging.getLogger(__name__)


def train_folds(
    dataset: Dataset,
    config: TrainConfig,
    folder: Path,
    *,
    folds: int,
    resume: bool = False,
) -> None:
    """Train one run a fold, in `folder/fold-0`, `folder/fold-1`, ...

    Raises:
        RunError: fewer than three folds, which leave no row for each part.
    """
    if folds < 3:
        raise RunError(f"{folds} folds", how="cross-validation takes 3 or more")
    for number in range(folds):
        logger.info(f"fold {number + 1} of {folds}")
        relabelled = dataset.relabelled(parse_split(f"fold:{number}/{folds}"))
        train(relabelled, config, folder / f"fold-{number}", resume=resume)


def fold_folders(folder: Path) -> list[Path]:
    """The runs of a cross-validation, in the order of the folds; empty if the folder is a single run."""
    return sorted(folder.glob("fold-*"), key=lambda path: int(path.name.removeprefix("fold-")))
