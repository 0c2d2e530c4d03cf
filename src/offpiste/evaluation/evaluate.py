"""Evaluation of models and baselines on the same windows."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.channels import without_optional
from offpiste.core.conventions import DT, EVALUATION_STRIDE
from offpiste.core.errors import RunError
from offpiste.core.shipped import names_apart
from offpiste.dataset.assumptions import assumptions_of
from offpiste.dataset.splits import Split
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import MODELS, Dynamics, Vehicle
from offpiste.evaluation.errors import Errors, errors_of_models
from offpiste.evaluation.evaluated_windows import EvaluatedWindows, share_driven_in_training
from offpiste.evaluation.intervals import Sampling
from offpiste.evaluation.metrics import (
    Case,
    LossUnits,
    Metrics,
    RunErrors,
    Start,
    WindowNumbers,
    band_rows,
    headlines,
    label,
    provenance,
    result_rows,
    seeded,
)
from offpiste.training.config import Weights
from offpiste.training.losses import COMPONENTS
from offpiste.training.prediction import Lookup
from offpiste.training.run import vehicle_of

logger = logging.getLogger(__name__)

Reading = tuple[Lookup | None, str | None]
"""Terrain lookup of a model, and its feature set at recorded places."""

NO_READING: Reading = (None, None)


@dataclass(frozen=True)
class EvaluatedModel:
    """Run of a model to evaluate.

    Attributes:
        name: in `offpiste.dynamics.MODELS`; runs of the same name and variant are one model.
        variant: distinguishes models of the same name, e.g. "flat".
        split: split to evaluate it on, for folds; None: that of the dataset.
    """

    name: str
    dynamics: Dynamics
    variant: str = ""
    seed: int | None = None
    fold: int | None = None
    split: Split | None = None

    @property
    def label(self) -> str:
        """Name of the model, and its variant if any."""
        return label(self.name, self.variant)


class Prediction(NamedTuple):
    """Errors of one run of a model, on the windows of one split and start, with one terrain lookup."""

    case: Case
    model: EvaluatedModel
    windows: Windows
    errors: Errors


@dataclass(frozen=True)
class Evaluation:
    """Result of an evaluation, from which figures of the report (`report_figures`) are drawn.

    Attributes:
        metrics: content of metrics.json.
        errors: by case, over all runs, on the same windows in the same order.
        windows: these windows.
        shown: the deciding case of the first model.
        predictions: of each run in each case.
    """

    metrics: Metrics
    errors: dict[Case, Errors]
    windows: EvaluatedWindows
    shown: Case
    predictions: Sequence[Prediction]


def evaluate_models(
    models: Sequence[EvaluatedModel],
    dataset: Dataset,
    *,
    scale: Float[Tensor, " 5"],
    weights: Weights | None = None,
    part: str = "test",
    starts: Sequence[Start] = ("causal", "smoothed"),
    lookups: Sequence[Lookup] = ("recorded", "map"),
    feature_sets: Sequence[str] = ("hindsight",),
    stride: int = EVALUATION_STRIDE,
    sampling: Sampling | None = None,
    device: torch.device | str = "cpu",
    command: str = "",
    warnings: Sequence[str] = (),
) -> Evaluation:
    """Evaluate models and the baselines `ctrv` and `kinematic` on the same windows.

    Args:
        models: runs; the report draws typical and worst windows of the first model.
        scale: units of the loss, the same for all models (`training.losses.loss_scale`).
        weights: of the loss.
        starts: estimates of the state that predictions start from.
        lookups: where models read the terrain; ignored for datasets without terrain.
        feature_sets: read at recorded places if there are features by distance (`conventions.FEATURE_SETS`).
        stride: rows between windows; if the dataset has snapshots of the map, their windows are used instead.
        sampling: settings of the intervals.
        command: command line for the report; empty: that of this process.
        warnings: for the report, in addition to those of the dataset.

    Raises:
        RunError: models were trained on different splits, or a run is given twice.
        DatasetError: the part has no windows.
    """
    weights, sampling = weights or Weights(), sampling or Sampling()
    models = with_baselines(models, dataset, device)
    groups = by_split(models, dataset)
    datasets = [each for each, _ in groups]
    readings = readings_of(datasets, part, lookups, feature_sets)
    predictions, cases = list[Prediction](), dict[Case, list[RunErrors]]()
    for case, model, windows in _every_reading(groups, part, starts, readings, device):
        name = " ".join(filter(None, ("evaluating", case.label, case.start, case.lookup, case.feature_set)))
        index = windows.evaluation_indices(stride)
        weighted = [(model.dynamics, torch.tensor(weights.in_order()))]
        (errors,) = errors_of_models(weighted, windows, index, lookup=case.lookup, scale=scale, description=name)
        predictions.append(Prediction(case, model, windows, errors))
        cases.setdefault(case, []).append(RunErrors(model.seed, model.fold, errors))
    together = seeded(cases)
    means = {case: runs.mean for case, runs in together.items()}
    first = next(iter(means.values()))
    evaluated = EvaluatedWindows(dataset, first.drive, first.row)
    metrics = Metrics(
        dataset=str(dataset.path),
        split=", ".join(each.split.text for each in datasets),
        part=part,
        made=provenance(command, sampling.seed, device),
        loss=LossUnits(
            dict(zip(COMPONENTS, weights.in_order(), strict=True)), dict(zip(COMPONENTS, scale.tolist(), strict=True))
        ),
        windows=_window_numbers(evaluated, datasets, part, stride, sampling),
        headlines=headlines(cases, sampling),
        results=result_rows(cases, part, sampling),
        warnings=(*dataset.findings, *warnings),
        assumptions=assumptions_of(dataset),
        features=bool(dataset.features),
        bands=band_rows(together, evaluated, sampling),
    )
    shown = [case for case in means if (case.label, case.start) == (models[0].label, starts[0])]
    return Evaluation(metrics, means, evaluated, max(shown, key=lambda case: case.lookup == "map"), predictions)


def _every_reading(
    groups: Sequence[tuple[Dataset, Sequence[EvaluatedModel]]],
    part: str,
    starts: Sequence[Start],
    readings: Sequence[Reading],
    device: torch.device | str,
) -> Iterator[tuple[Case, EvaluatedModel, Windows]]:
    """Yield each model with each start and terrain lookup, on the windows of its split."""
    for dataset, models in groups:
        for start in starts:
            windows = Windows(dataset, part, start=start, device=device)
            for model in models:
                for lookup, chosen in readings if model.dynamics.reads_terrain else (NO_READING,):
                    read = windows.with_feature_set(chosen) if chosen else windows
                    yield Case(model.name, model.variant, start, lookup, chosen), model, read


def _window_numbers(
    windows: EvaluatedWindows, datasets: Sequence[Dataset], part: str, stride: int, sampling: Sampling
) -> WindowNumbers:
    return WindowNumbers(
        n=len(windows.row),
        drives=len(np.unique(windows.drive)),
        stride_s=round(windows.usual_step(stride) * DT, 6),
        blocks=sampling.on(windows).blocks,
        block_s=sampling.block_seconds,
        median_distance_m=float(np.median(windows.driven_distance)),
        median_speed_mps=float(np.median(windows.start_speed)),
        driven_in_training=float(np.mean([share_driven_in_training(dataset, part) for dataset in datasets])),
    )


def readings_of(
    datasets: Sequence[Dataset], part: str, lookups: Sequence[Lookup], feature_sets: Sequence[str]
) -> Sequence[Reading]:
    """Return the possible terrain lookups among the wanted ones; on the map only if every split has maps.

    Args:
        datasets: the same rows with each split.
        part: of the splits, whose windows are evaluated.
    """
    featured = bool(datasets[0].features)
    if not featured and not any((np.abs(drive.rows.normal[..., :2]) > 0).any() for drive in datasets[0].drives):
        return (NO_READING,)
    windows = [Windows(dataset, part) for dataset in datasets]
    bare = [
        dataset.split.text for dataset, each in zip(datasets, windows, strict=True) if featured and not each.maps.any
    ]
    if bare and "map" in lookups:
        logger.info(f"models are not evaluated on the map: windows of the split {', '.join(bare)} have no map")
    sets: Sequence[str | None] = tuple(feature_sets) if windows[-1].sets > 1 else (None,)
    recorded: list[Reading] = [("recorded", chosen) for chosen in sets] if "recorded" in lookups or bare else []
    on_map: list[Reading] = [("map", None)] if "map" in lookups and not bare else []
    return recorded + on_map


def named_apart(models: Sequence[EvaluatedModel], folders: Sequence[Path]) -> list[EvaluatedModel]:
    """Distinguish models whose runs have the same seed and fold, with the names of their folders as variants.

    Folders named MODEL or MODEL-SEED give no variant.

    Args:
        folders: of each run, as given; for folds, the folder of the cross-validation.
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
    """Add the missing baselines, once for every split.

    Raises:
        RunError: models were trained on different splits, or a run is given twice.
    """
    result, vehicle = list(models), vehicle_of(dataset)
    splits = list(dict.fromkeys(model.split for model in models)) or [None]
    for name, declared in MODELS.items():
        if declared.baseline and declared.fits(vehicle) and all(model.label != name for model in models):
            for split in splits:
                beside = [model for model in models if model.split == split]
                baseline, fold = _baseline(name, beside, vehicle).to(device), beside[0].fold if beside else None
                result.append(EvaluatedModel(name, baseline, fold=fold, split=split))
    for name in dict.fromkeys(model.label for model in result):
        runs = [model for model in result if model.label == name]
        evaluated = [run.split or dataset.split for run in runs]
        missing = [wanted.text for wanted in (split or dataset.split for split in splits) if wanted not in evaluated]
        if missing:
            what = f"model '{name}' has no run for split {', '.join(missing)}, which others have"
            how = "give the same folds of each model, or evaluate them separately"
            raise RunError(what, where=dataset.path, how=how)
        if len({_identity(run) for run in runs}) < len(runs):
            what = f"two runs of model '{name}' have the same seed and fold"
            raise RunError(what, where=dataset.path, how="give each run once")
    return result


def _baseline(name: str, beside: Sequence[EvaluatedModel], vehicle: Vehicle) -> Dynamics:
    """Return a baseline; its actuators, if any, have the delays fitted by the first model of the same channels."""

    def channels(of: Vehicle) -> tuple[tuple[str, ...], ...]:
        return without_optional(of.control), of.actuators

    baseline = MODELS[name](vehicle, seed=0)
    alike = (model.dynamics for model in beside if channels(model.dynamics.vehicle) == channels(vehicle))
    fitted = next((dynamics.actuators for dynamics in alike if dynamics.actuators is not None), None)
    if baseline.actuators is not None and fitted is not None:
        baseline.actuators.load_state_dict(fitted.state_dict())
    return baseline


def by_split(models: Sequence[EvaluatedModel], dataset: Dataset) -> list[tuple[Dataset, list[EvaluatedModel]]]:
    """Return the dataset with each split, and the models evaluated on it.

    With several splits there are no snapshots, so that windows are chosen in the same way for each.
    """
    splits = list(dict.fromkeys(model.split or dataset.split for model in models)) or [dataset.split]
    datasets = [dataset] if splits == [dataset.split] else [dataset.relabelled(split) for split in splits]
    return [(each, [model for model in models if (model.split or dataset.split) == each.split]) for each in datasets]
