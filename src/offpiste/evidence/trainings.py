"""The epoch that each training kept: a model whose every run kept its start learned nothing."""

from collections.abc import Sequence
from typing import Final

from offpiste.report.text_table import TextTable, number
from offpiste.reproduction.settings import FigureModel, ReproductionSettings
from offpiste.training.kept_epoch import KeptEpoch
from offpiste.training.run import kept_epochs

STAGE: Final = "model"
"""Stage of training that networks learn in; before it there is the physics alone."""

NOTHING: Final = "learned nothing"


def has_learned(settings: ReproductionSettings, model: FigureModel) -> bool:
    """Whether any run kept an epoch: otherwise all predict as the physics alone, with features or without."""
    kept = [_kept(settings, model, seed) for seed in range(settings.size.seeds)]
    return any(one is None or one.epoch != 0 for one in kept)


def trainings_table(settings: ReproductionSettings, models: Sequence[FigureModel]) -> TextTable:
    """A line a run."""
    lines = []
    for model in models:
        for seed in range(settings.size.seeds):
            one = _kept(settings, model, seed)
            if one is None or one.epoch is None:
                lines.append((model.label, str(seed), "–", "–", "not noted"))
                continue
            loss = "–" if one.validation_loss is None else number(one.validation_loss, 4)
            lines.append((model.label, str(seed), f"{one.epoch} of {one.epochs}", loss, _remark(one)))
    about = (
        "The epoch with the least validation loss is kept. A run that kept epoch 0 equals its start, the physics "
        "alone. It says nothing of features, nor does a comparison with a b that kept it."
    )
    return TextTable("Trainings", ("model", "seed", "kept epoch", "validation loss", "remark"), tuple(lines), about)


def _kept(settings: ReproductionSettings, model: FigureModel, seed: int) -> KeptEpoch | None:
    return kept_epochs(settings.runs / model.folder(seed)).get(STAGE)


def _remark(kept: KeptEpoch) -> str:
    if kept.epoch == 0:
        return "equals its start: no epoch was better"
    return "" if kept.has_converged else "the last epoch: it may not have converged"
