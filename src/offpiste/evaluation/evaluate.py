"""Evaluate models on the same windows: the one place where models, windows and statistics meet."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import DT, EVALUATION_STRIDE
from offpiste.dataset.assumptions import assumptions_of
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.errors import Errors, Progress, no_progress, prediction_errors
from offpiste.evaluation.evaluated_models import (
    NO_READING,
    EvaluatedModel,
    Reading,
    by_split,
    readings_of,
    with_baselines,
)
from offpiste.evaluation.evaluated_windows import EvaluatedWindows, share_driven_in_training
from offpiste.evaluation.intervals import Sampling
from offpiste.evaluation.metrics import LossUnits, Metrics, WindowNumbers, provenance
from offpiste.evaluation.result_rows import Case, Cases, RunErrors, Start, headlines, result_rows, seeded
from offpiste.evaluation.speed_bands import band_rows
from offpiste.training.config import Weights
from offpiste.training.losses import COMPONENTS
from offpiste.training.prediction import Lookup


class Prediction(NamedTuple):
    """Errors of one run of a model, on the windows of one split and start, reading the terrain in one way."""

    case: Case
    model: EvaluatedModel
    windows: Windows
    errors: Errors


@dataclass(frozen=True)
class Evaluation:
    """Outcome of an evaluation; figures of the report (`report_figures`) draw from it.

    Attributes:
        metrics: content of metrics.json.
        errors: by case, over all runs; the same windows in the same order in each.
        windows: these windows, with their speeds and whatever else the dataset knows of them.
        shown: the case that decides about the model that was named first.
        predictions: each run in each case, with its model and its windows.
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
    track: Progress = no_progress,
) -> Evaluation:
    """Evaluate models, and with them `ctrv` and `kinematic`, on the same windows.

    Args:
        models: runs; the first names the model whose worst windows are drawn.
        scale: of the loss, one for all models so that their losses compare (`training.losses.loss_scale`).
        weights: of the loss.
        starts: estimates of the state that predictions start from.
        lookups: where models read the terrain; datasets without slope have only one way.
        feature_sets: read at recorded places where there are features by distance (`conventions.FEATURE_SETS`).
        stride: rows between windows; where the dataset keeps snapshots of the map, their windows are taken instead.
        sampling: settings of the intervals.
        command: command line for the report; empty: this process's own.
        warnings: for the report, beside those of the dataset.
        track: shows progress, e.g. `offpiste.core.progress.track`.

    Raises:
        RunError: models were trained under different splits, or two runs are the same one.
        DatasetError: the part has no windows.
    """
    weights, sampling = weights or Weights(), sampling or Sampling()
    models = with_baselines(models, dataset, device)
    groups = by_split(models, dataset)
    datasets = [each for each, _ in groups]
    readings = readings_of(datasets, part, lookups, feature_sets)
    compute = partial(prediction_errors, scale=scale, weights=torch.tensor(weights.in_order()), track=track)
    predictions = [
        Prediction(
            case,
            model,
            windows,
            compute(
                model.dynamics,
                windows,
                windows.evaluation_indices(stride),
                lookup=case.lookup,
                description=_described(case),
            ),
        )
        for case, model, windows in _every_reading(groups, part, starts, readings, device)
    ]
    cases = _by_case(predictions)
    together = seeded(cases)
    errors = {case: runs.mean for case, runs in together.items()}
    first = next(iter(errors.values()))
    windows = EvaluatedWindows(dataset, first.drive, first.row)
    metrics = Metrics(
        dataset=str(dataset.path),
        split=", ".join(each.split.text for each in datasets),
        part=part,
        made=provenance(command, sampling.seed, device),
        loss=_loss_units(weights, scale),
        windows=_window_numbers(windows, datasets, part, stride, sampling),
        headlines=headlines(cases, sampling),
        results=result_rows(cases, part, sampling),
        warnings=(*dataset.findings, *warnings),
        assumptions=assumptions_of(dataset),
        features=bool(dataset.features),
        bands=band_rows(together, windows, sampling),
    )
    return Evaluation(metrics, errors, windows, _shown_case(errors, models[0], starts[0]), predictions)


def _described(case: Case) -> str:
    return " ".join(filter(None, ("evaluating", case.label, case.start, case.lookup, case.feature_set)))


def _every_reading(
    groups: Sequence[tuple[Dataset, Sequence[EvaluatedModel]]],
    part: str,
    starts: Sequence[Start],
    readings: Sequence[Reading],
    device: torch.device | str,
) -> Iterator[tuple[Case, EvaluatedModel, Windows]]:
    """Each model from each start, reading the terrain in each way, on the windows of its split."""
    for dataset, models in groups:
        for start in starts:
            windows = Windows(dataset, part, start=start, device=device)
            for model in models:
                for lookup, chosen in readings if model.dynamics.reads_terrain else (NO_READING,):
                    read = windows.with_feature_set(chosen) if chosen else windows
                    yield Case(model.name, model.variant, start, lookup, chosen), model, read


def _by_case(predictions: Sequence[Prediction]) -> Cases:
    cases: dict[Case, list[RunErrors]] = {}
    for prediction in predictions:
        run = RunErrors(prediction.model.seed, prediction.model.fold, prediction.errors)
        cases.setdefault(prediction.case, []).append(run)
    return cases


def _shown_case(errors: dict[Case, Errors], model: EvaluatedModel, start: Start) -> Case:
    """The case that decides about a model: from the first start, on the map where there is one."""
    result = [case for case in errors if case.label == model.label and case.start == start]
    return max(result, key=lambda case: case.lookup == "map")


def _loss_units(weights: Weights, scale: Float[Tensor, " 5"]) -> LossUnits:
    of_weights, of_scale = (
        dict(zip(COMPONENTS, result, strict=True)) for result in (weights.in_order(), scale.tolist())
    )
    return LossUnits(of_weights, of_scale)


def _window_numbers(
    windows: EvaluatedWindows, datasets: Sequence[Dataset], part: str, stride: int, sampling: Sampling
) -> WindowNumbers:
    shares = [share_driven_in_training(dataset, part) for dataset in datasets]
    return WindowNumbers(
        n=len(windows.row),
        drives=len(np.unique(windows.drive)),
        stride_s=round(windows.usual_step(stride) * DT, 6),
        blocks=sampling.on(windows).blocks,
        block_s=sampling.block_seconds,
        median_distance_m=float(np.median(windows.driven_distance)),
        median_speed_mps=float(np.median(windows.start_speed)),
        driven_in_training=float(np.mean(shares)),
    )
