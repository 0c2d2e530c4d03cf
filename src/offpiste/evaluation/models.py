"""Where models read the ground: under the recorded wheels or on a map, and from which distance it was seen.

The models that are judged together: runs, and the baselines beside them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from offpiste.dataset.splits import Split
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import MODELS, Dynamics, Vehicle
from offpiste.errors import RunError
from offpiste.evaluation.results import label
from offpiste.evaluation.tables import Lookup
from offpiste.training.run import vehicle_of

Reading = tuple[Lookup | None, str | None]
"""Where a model reads the ground, and from which distance it was seen."""

NO_READING: Reading = (None, None)


def readings_of(
    dataset: Dataset, part: str, lookups: Sequence[Lookup], feature_sets: Sequence[str]
) -> Sequence[Reading]:
    """Where models can read the ground: features without a map only where they were recorded.

    Args:
        part: whose windows are judged.
        lookups, feature_sets: that are asked for.
    """
    if not _has_ground(dataset):
        return (NO_READING,)
    windows = Windows(dataset, part)
    mapped = not dataset.features or windows.maps.any
    sets = tuple(feature_sets) if windows.sets > 1 else (None,)
    recorded: list[Reading] = [("recorded", chosen) for chosen in sets] if "recorded" in lookups or not mapped else []
    on_map: list[Reading] = [("map", None)] if "map" in lookups and mapped else []
    return recorded + on_map


def _has_ground(dataset: Dataset) -> bool:
    """Whether there is anything to read from the ground."""
    return bool(dataset.features) or any(
        bool(np.nanmax(np.abs(drive.rows.normal[..., :2]), initial=0) > 0) for drive in dataset.drives
    )


@dataclass(frozen=True)
class Judged:
    """A model to be judged.

    Attributes:
        name: in `offpiste.dynamics.MODELS`; runs of the same name and variant are one model.
        variant: what else tells it from models of its name, e.g. "flat".
        seed, fold: of the run.
        split: that judges it, when not the dataset's own (folds).
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


def with_baselines(models: Sequence[Judged], dataset: Dataset, device: torch.device | str) -> list[Judged]:
    """The models, and baselines that are not among them, once for every split.

    Raises:
        RunError: models are to be judged under different splits, or two runs are the same one.
    """
    found = list(models)
    for name in (name for name, model in MODELS.items() if model.baseline):
        if any(model.label == name for model in models):
            continue
        for split in dict.fromkeys(model.split for model in models) or {None: None}:
            beside = [model for model in models if model.split == split]
            fold = beside[0].fold if beside else None
            found.append(Judged(name, _baseline(name, beside, dataset).to(device), fold=fold, split=split))
    _refuse_unlike(found, dataset)
    return found


def _baseline(name: str, beside: Sequence[Judged], dataset: Dataset) -> Dynamics:
    """A baseline; its actuators, if it has any, have the delays that a model beside it fitted."""
    vehicle = vehicle_of(dataset)
    baseline = MODELS[name](vehicle)
    fitted = [model.dynamics.actuators for model in beside if _channels(model.dynamics.vehicle) == _channels(vehicle)]
    found = next((lags for lags in fitted if lags is not None), None)
    if baseline.actuators is not None and found is not None:
        baseline.actuators.load_state_dict(found.state_dict())
    return baseline


def _channels(vehicle: Vehicle) -> tuple[tuple[str, ...], ...]:
    return vehicle.control, vehicle.actuators


def _refuse_unlike(models: Sequence[Judged], dataset: Dataset) -> None:
    """Every model must be judged on the same windows, and every run once."""
    wanted = set(splits_of(models, dataset))
    for name in dict.fromkeys(model.label for model in models):
        runs = [model for model in models if model.label == name]
        splits = {run.split or dataset.split for run in runs}
        if splits != wanted:
            missing = ", ".join(split.text for split in wanted - splits)
            raise RunError(
                f"model '{name}' has no run for split {missing}, which others have",
                where=dataset.path,
                how="models compare on the same windows only: give the same folds of each, or judge them one by one",
            )
        identities = [(run.seed, run.fold, run.split) for run in runs]
        if len(set(identities)) < len(identities):
            raise RunError(
                f"two runs of model '{name}' have the same seed and fold",
                where=dataset.path,
                how="give each run once, or tell them apart by a variant",
            )


def splits_of(models: Sequence[Judged], dataset: Dataset) -> list[Split]:
    """Splits that models are judged under; the dataset's own where none of them says otherwise."""
    return list(dict.fromkeys(model.split or dataset.split for model in models)) or [dataset.split]
