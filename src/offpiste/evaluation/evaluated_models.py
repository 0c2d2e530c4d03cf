"""Models that are evaluated together: runs, the baselines beside them, and where they read the terrain."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from offpiste.core.channels import without_optional
from offpiste.core.errors import RunError
from offpiste.core.shipped import names_apart
from offpiste.dataset.splits import Split
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import MODELS, Dynamics, Vehicle
from offpiste.evaluation.metrics import label
from offpiste.training.prediction import Lookup
from offpiste.training.run import vehicle_of

logger = logging.getLogger(__name__)

Reading = tuple[Lookup | None, str | None]
"""Terrain lookup of a model, and the feature set that it reads at recorded places."""

NO_READING: Reading = (None, None)


def readings_of(
    datasets: Sequence[Dataset], part: str, lookups: Sequence[Lookup], feature_sets: Sequence[str]
) -> Sequence[Reading]:
    """Ways in which models can read the terrain: features only at recorded places, unless every split has maps.

    Args:
        datasets: the same rows under each split.
        part: of the splits, whose windows are evaluated.
        lookups, feature_sets: those wanted.
    """
    if not _has_terrain(datasets[0]):
        return (NO_READING,)
    sets: Sequence[str | None] = (None,)
    bare: list[str] = []
    for dataset in datasets:
        windows = Windows(dataset, part)
        sets = tuple(feature_sets) if windows.sets > 1 else (None,)
        if dataset.features and not windows.maps.any:
            bare.append(dataset.split.text)
    if bare and "map" in lookups:
        logger.info(f"models are not evaluated on the map: windows of the split {', '.join(bare)} have none")
    recorded: list[Reading] = [("recorded", chosen) for chosen in sets] if "recorded" in lookups or bare else []
    on_map: list[Reading] = [("map", None)] if "map" in lookups and not bare else []
    return recorded + on_map


def _has_terrain(dataset: Dataset) -> bool:
    """Whether the dataset has anything that models can read from the terrain: features or slopes."""
    return bool(dataset.features) or any(
        bool(np.nanmax(np.abs(drive.rows.normal[..., :2]), initial=0) > 0) for drive in dataset.drives
    )


@dataclass(frozen=True)
class EvaluatedModel:
    """A run of a model, to be evaluated.

    Attributes:
        name: in `offpiste.dynamics.MODELS`; runs of the same name and variant are one model.
        variant: what tells it from other models of its name, e.g. "flat".
        seed, fold: of the run.
        split: whose test part it is evaluated on, when not the dataset's own (folds).
    """

    name: str
    dynamics: Dynamics
    variant: str = ""
    seed: int | None = None
    fold: int | None = None
    split: Split | None = None

    @property
    def label(self) -> str:
        """The model's name, and its variant if it has one."""
        return label(self.name, self.variant)


def named_apart(models: Sequence[EvaluatedModel], folders: Sequence[Path]) -> list[EvaluatedModel]:
    """Models whose runs would have the same seed and fold, with the names of their folders as variants.

    A folder that is called as its model, and perhaps "-SEED", holds the one without a variant.

    Args:
        folders: of each run, as given; a folder of folds for each of its folds.
    """
    result = list(models)
    for name in dict.fromkeys(model.name for model in models):
        mine = [i for i, model in enumerate(models) if model.name == name]
        own = list(dict.fromkeys(folders[i] for i in mine))
        called = dict(zip(own, names_apart(own), strict=True))
        for by_seed in (True, False):
            if len({_identity(result[i]) for i in mine}) == len(mine):
                break
            for i in mine:
                of_seed = called[folders[i]].removesuffix(f"-{models[i].seed}" if by_seed else "")
                result[i] = replace(models[i], variant="" if of_seed == name else of_seed)
    return result


def _identity(model: EvaluatedModel) -> tuple[str, int | None, int | None, Split | None]:
    return model.label, model.seed, model.fold, model.split


def with_baselines(
    models: Sequence[EvaluatedModel], dataset: Dataset, device: torch.device | str
) -> list[EvaluatedModel]:
    """The models, and the baselines that are not among them, once for every split.

    Raises:
        RunError: models were trained under different splits, or two runs are the same one.
    """
    result = list(models)
    vehicle = vehicle_of(dataset)
    for name in (name for name, model in MODELS.items() if model.baseline and model.fits(vehicle)):
        if any(model.label == name for model in models):
            continue
        for split in dict.fromkeys(model.split for model in models) or {None: None}:
            beside = [model for model in models if model.split == split]
            fold = beside[0].fold if beside else None
            result.append(EvaluatedModel(name, _baseline(name, beside, vehicle).to(device), fold=fold, split=split))
    _refuse_unlike(result, dataset)
    return result


def _baseline(name: str, beside: Sequence[EvaluatedModel], vehicle: Vehicle) -> Dynamics:
    """A baseline; its actuators, if it has any, have the delays that a model beside it fitted."""
    baseline = MODELS[name](vehicle, seed=0)
    fitted = [model.dynamics.actuators for model in beside if _channels(model.dynamics.vehicle) == _channels(vehicle)]
    result = next((lags for lags in fitted if lags is not None), None)
    if baseline.actuators is not None and result is not None:
        baseline.actuators.load_state_dict(result.state_dict())
    return baseline


def _channels(vehicle: Vehicle) -> tuple[tuple[str, ...], ...]:
    return without_optional(vehicle.control), vehicle.actuators


def _refuse_unlike(models: Sequence[EvaluatedModel], dataset: Dataset) -> None:
    """Raise if models would be evaluated on different windows, or a run twice."""
    wanted = set(splits_of(models, dataset))
    for name in dict.fromkeys(model.label for model in models):
        runs = [model for model in models if model.label == name]
        splits = {run.split or dataset.split for run in runs}
        if splits != wanted:
            missing = ", ".join(split.text for split in wanted - splits)
            raise RunError(
                f"model '{name}' has no run for split {missing}, which others have",
                where=dataset.path,
                how="models compare on the same windows only: give the same folds of each, or evaluate them one by one",
            )
        if len({_identity(run) for run in runs}) < len(runs):
            raise RunError(
                f"two runs of model '{name}' have the same seed and fold",
                where=dataset.path,
                how="give each run once",
            )


def splits_of(models: Sequence[EvaluatedModel], dataset: Dataset) -> list[Split]:
    """Splits that models are evaluated under; the dataset's own where none of them has another."""
    return list(dict.fromkeys(model.split or dataset.split for model in models)) or [dataset.split]


def by_split(models: Sequence[EvaluatedModel], dataset: Dataset) -> list[tuple[Dataset, list[EvaluatedModel]]]:
    """The dataset under each split that models are evaluated under, with these models.

    Of several splits none has snapshots, so that windows are chosen alike in all of them.
    """
    splits = splits_of(models, dataset)
    datasets = [dataset] if splits == [dataset.split] else [dataset.relabelled(split) for split in splits]
    return [(each, [model for model in models if (model.split or dataset.split) == each.split]) for each in datasets]
