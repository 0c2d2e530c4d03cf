"""What the judged windows are like: how fast, how far, and whether training has driven there before.

Judge models on the same windows: the one place where models, windows and statistics meet.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from torch import Tensor

from offpiste.conventions import DT, EVALUATION_STRIDE, HORIZON_STEPS
from offpiste.dataset.splits import PARTS, Split
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.errors import Errors, Track, predict, untracked
from offpiste.evaluation.models import NO_READING, Judged, Reading, readings_of, splits_of, with_baselines
from offpiste.evaluation.results import LossUnits, Metrics, WindowNumbers, provenance
from offpiste.evaluation.tables import Case, Cases, Lookup, RunErrors, Sampling, Start, headlines, pooled, result_rows
from offpiste.evaluation.worst_windows import WorstWindow, draw_worst, worst_windows
from offpiste.training.config import Weights
from offpiste.training.losses import COMPONENTS

NEAR = 5.0
"""A place counts as driven in training within this distance [m]."""


def start_speeds(dataset: Dataset, drive: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Speed at the start of windows, by the causal estimate [m/s]."""
    speed = [np.hypot(*d.rows.state_causal[:, 3:5].T.astype(float)) for d in dataset.drives]
    return np.array([speed[d][r] for d, r in zip(drive, row, strict=True)], dtype=float)


def driven_distances(
    dataset: Dataset, drive: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], *, steps: int = HORIZON_STEPS
) -> Float[np.ndarray, " n"]:
    """Metres driven along the path in the 5 s of each window."""
    # Rows outside of any window may be NaN and must not spoil the running sum.
    run = [
        np.concatenate(([0.0], np.cumsum(np.nan_to_num(np.hypot(*d.rows.state[:, 3:5].T.astype(float))) * DT)))
        for d in dataset.drives
    ]
    return np.array([run[d][r + steps] - run[d][r] for d, r in zip(drive, row, strict=True)], dtype=float)


def share_driven_in_training(dataset: Dataset, part: str = "test", *, near: float = NEAR) -> float:
    """Share of a part's path (by metres) that training rows of any drive pass within `near` metres.

    Drives are compared by their positions in the log's world frame; where each drive has a world of its own, places of
    different drives coincide by chance only. 0 where nothing is trained on, nan where the part has no path.
    """
    trained = np.concatenate([_places(dataset, number, "train")[0] for number in range(len(dataset.drives))])
    judged = [_places(dataset, number, part) for number in range(len(dataset.drives))]
    places = np.concatenate([place for place, _ in judged])
    metres = np.concatenate([length for _, length in judged])
    if metres.sum() == 0:
        return float("nan")
    if not len(trained):
        return 0.0
    distance, _ = cKDTree(trained).query(places, distance_upper_bound=near)
    return float(metres[np.isfinite(distance)].sum() / metres.sum())


def _places(dataset: Dataset, number: int, part: str) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """World positions of a part's valid rows in one drive, and the metres driven in each."""
    drive = dataset.drives[number]
    chosen = drive.rows.valid & (drive.part == PARTS.index(part))
    state = drive.rows.state[chosen].astype(float)
    return state[:, :2] + drive.rows.origin, np.hypot(state[:, 3], state[:, 4]) * DT


@dataclass(frozen=True)
class Evaluation:
    """What an evaluation found.

    Attributes:
        metrics: what goes to metrics.json.
        errors: by case, over all runs; the same windows in the same order in each.
        speed: at the start of those windows [m/s].
        shown: the model that was named first, and where it reads the ground.
        worst: its worst windows.
    """

    metrics: Metrics
    errors: dict[Case, Errors]
    speed: Float[np.ndarray, " n"]
    shown: str
    worst: tuple[WorstWindow, ...]


class _Prediction(NamedTuple):
    """One run of a model, on the windows of one split and start, reading the ground in one way."""

    case: Case
    model: Judged
    windows: Windows
    errors: Errors


def evaluate_models(
    models: Sequence[Judged],
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
    track: Track = untracked,
) -> Evaluation:
    """Judge models, and with them `ctrv` and `kinematic`, on the same windows.

    Args:
        models: runs; the first names the model whose worst windows are drawn.
        scale: of the loss, one for all models so that their losses compare (`offpiste.training.train.kinematic_scale`).
        weights: of the loss.
        starts: estimates of the state that predictions start from.
        lookups: where models read the ground; datasets without slope have only one way.
        feature_sets: read at recorded places where there are views by distance (`conventions.FEATURE_SETS`).
        stride: rows between windows; where the dataset keeps snapshots of the map, their windows are judged instead.
        sampling: blocks and seed of the intervals.
        command: that asked for it, for the report; empty: this process's own.
        track: shows progress, e.g. `offpiste.progress.track`.

    Raises:
        RunError: models are to be judged under different splits, or two runs are the same one.
        DatasetError: the part has no windows.
    """
    weights, sampling = weights or Weights(), sampling or Sampling()
    models = with_baselines(models, dataset, device)
    readings = readings_of(dataset, part, lookups, feature_sets)
    judge = partial(predict, scale=scale, weights=torch.tensor(weights.in_order()), track=track)
    predictions = [
        _Prediction(
            case,
            model,
            windows,
            judge(model.dynamics, windows, windows.judged(stride), lookup=case.lookup, description=_described(case)),
        )
        for case, model, windows in _every_reading(models, dataset, part, starts, readings, device)
    ]
    cases = _by_case(predictions)
    errors = pooled(cases)
    shown = _shown_case(errors, models[0], starts[0])
    windows = next(iter(errors.values()))
    speed = start_speeds(dataset, windows.drive, windows.row)
    splits = splits_of(models, dataset)
    return Evaluation(
        metrics=Metrics(
            dataset=str(dataset.path),
            split=", ".join(split.text for split in splits),
            part=part,
            made=provenance(command, sampling.seed, device),
            loss=_loss_units(weights, scale),
            windows=_window_numbers(dataset, splits, part, windows, speed, stride, sampling),
            headlines=headlines(cases, sampling),
            results=result_rows(cases, part, sampling),
        ),
        errors=errors,
        speed=speed,
        shown=shown.reading,
        worst=draw_worst(
            worst_windows(errors[shown]),
            [(p.case, p.model.dynamics, p.windows) for p in predictions],
            shown=shown,
            dataset=dataset,
        ),
    )


def _described(case: Case) -> str:
    return " ".join(filter(None, ("judging", case.label, case.start, case.lookup, case.feature_set)))


def _every_reading(
    models: Sequence[Judged],
    dataset: Dataset,
    part: str,
    starts: Sequence[Start],
    readings: Sequence[Reading],
    device: torch.device | str,
) -> Iterator[tuple[Case, Judged, Windows]]:
    """Each model from each start, reading the ground in each way, on the windows of its split."""
    for split in splits_of(models, dataset):
        parted = dataset if split == dataset.split else dataset.relabelled(split)
        for start in starts:
            windows = Windows(parted, part, start=start, device=device)
            for model in models:
                if (model.split or dataset.split) == split:
                    for lookup, chosen in readings if model.dynamics.reads_terrain else (NO_READING,):
                        read = windows.reading(chosen) if chosen else windows
                        yield Case(model.name, model.variant, start, lookup, chosen), model, read


def _by_case(predictions: Sequence[_Prediction]) -> Cases:
    cases: dict[Case, list[RunErrors]] = {}
    for prediction in predictions:
        run = RunErrors(prediction.model.seed, prediction.model.fold, prediction.errors)
        cases.setdefault(prediction.case, []).append(run)
    return cases


def _shown_case(errors: dict[Case, Errors], model: Judged, start: Start) -> Case:
    """The way of judging `model` that decides: from the first start, on the map where there is one."""
    found = [case for case in errors if case.label == model.label and case.start == start]
    return max(found, key=lambda case: case.lookup == "map")


def _loss_units(weights: Weights, scale: Float[Tensor, " 5"]) -> LossUnits:
    of_weights, of_scale = (dict(zip(COMPONENTS, found, strict=True)) for found in (weights.in_order(), scale.tolist()))
    return LossUnits(of_weights, of_scale)


def _usual_step(windows: Errors, stride: int) -> float:
    """Rows between judged windows: `stride`, or more where only windows with a snapshot of the map are judged."""
    key = np.sort(np.unique(windows.key))
    steps = np.diff(key & 0xFFFFFFFF)[np.diff(key >> 32) == 0]
    return float(np.median(steps)) if len(steps) else float(stride)


def _window_numbers(
    dataset: Dataset,
    splits: Sequence[Split],
    part: str,
    windows: Errors,
    speed: Float[np.ndarray, " n"],
    stride: int,
    sampling: Sampling,
) -> WindowNumbers:
    shares = [share_driven_in_training(dataset.relabelled(split), part) for split in splits]
    return WindowNumbers(
        n=len(windows.row),
        drives=len(np.unique(windows.drive)),
        stride_s=round(_usual_step(windows, stride) * DT, 6),
        blocks=sampling.on(windows).blocks,
        block_s=sampling.block_seconds,
        median_distance_m=float(np.median(driven_distances(dataset, windows.drive, windows.row))),
        median_speed_mps=float(np.median(speed)),
        driven_in_training=float(np.mean(shares)),
    )
