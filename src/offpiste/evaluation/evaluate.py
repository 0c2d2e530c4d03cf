"""Judge models on the same windows: the one place where models, windows and statistics meet."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.conventions import DT, JUDGED_STRIDE
from offpiste.dataset.splits import Split
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import ConstantMotion, Dynamics, Kinematic
from offpiste.dynamics.actuators import Actuators
from offpiste.errors import RunError
from offpiste.evaluation.judge import Errors, Track, predict, untracked
from offpiste.evaluation.overlap import driven_distances, share_driven_in_training, start_speeds
from offpiste.evaluation.provenance import provenance
from offpiste.evaluation.results import LossUnits, Metrics, WindowNumbers, label
from offpiste.evaluation.tabulate import (
    REFERENCE,
    Case,
    Cases,
    Lookup,
    RunErrors,
    Sampling,
    Start,
    headlines,
    pooled,
    result_rows,
)
from offpiste.evaluation.worst import WorstWindow, draw_worst, worst_windows
from offpiste.training.config import Weights
from offpiste.training.losses import COMPONENTS
from offpiste.training.run import vehicle_of

GROUND_BLIND = ("ctrv", REFERENCE)
"""Models that do not read the ground: there is nothing to look up."""

Way = tuple[Lookup | None, str | None]
"""Where a model reads the ground, and from which distance it was seen."""

NO_WAY: Way = (None, None)


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
    stride: int = JUDGED_STRIDE,
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
    models = _with_baselines(models, dataset, device)
    ways = _ways(dataset, part, lookups, feature_sets)

    predictions = [
        _Prediction(
            case,
            model,
            windows,
            predict(
                model.dynamics,
                windows,
                windows.judged(stride),
                lookup=case.lookup,
                scale=scale,
                weights=torch.tensor(weights.in_order()),
                track=track,
                description=" ".join(filter(None, ("judging", case.label, case.start, case.lookup, case.feature_set))),
            ),
        )
        for case, model, windows in _every_way(models, dataset, part, starts, ways, device)
    ]
    cases = _by_case(predictions)
    errors = pooled(cases)
    shown = _shown_case(errors, models[0], starts[0])
    windows = next(iter(errors.values()))
    speed = start_speeds(dataset, windows.drive, windows.row)
    splits = _splits(models, dataset)
    return Evaluation(
        metrics=Metrics(
            dataset=str(dataset.path),
            split=", ".join(split.text for split in splits),
            part=part,
            made=provenance(command, sampling.seed, device),
            loss=LossUnits(
                dict(zip(COMPONENTS, weights.in_order(), strict=True)),
                dict(zip(COMPONENTS, scale.tolist(), strict=True)),
            ),
            windows=_window_numbers(dataset, splits, part, windows, speed, stride, sampling),
            headlines=headlines(cases, sampling),
            results=result_rows(cases, part, sampling),
        ),
        errors=errors,
        speed=speed,
        shown=shown.way,
        worst=draw_worst(
            worst_windows(errors[shown]),
            [(p.case, p.model.dynamics, p.windows) for p in predictions],
            shown=shown,
            dataset=dataset,
        ),
    )


def _every_way(
    models: Sequence[Judged],
    dataset: Dataset,
    part: str,
    starts: Sequence[Start],
    ways: Sequence[Way],
    device: torch.device | str,
) -> Iterator[tuple[Case, Judged, Windows]]:
    """Each model from each start, reading the ground in each way, on the windows of its split."""
    for split in _splits(models, dataset):
        parted = dataset if split == dataset.split else dataset.relabelled(split)
        for start in starts:
            windows = Windows(parted, part, start=start, device=device)
            for model in models:
                if (model.split or dataset.split) == split:
                    for lookup, chosen in (NO_WAY,) if model.name in GROUND_BLIND else ways:
                        read = windows.reading(chosen) if chosen else windows
                        yield Case(model.name, model.variant, start, lookup, chosen), model, read


def _with_baselines(models: Sequence[Judged], dataset: Dataset, device: torch.device | str) -> list[Judged]:
    """The models, and baselines that are not among them, once for every split."""
    found = list(models)
    for name in GROUND_BLIND:
        if any(model.label == name for model in models):
            continue
        for split in dict.fromkeys(model.split for model in models) or {None: None}:
            beside = [model for model in models if model.split == split]
            fold = beside[0].fold if beside else None
            found.append(Judged(name, _baseline(name, beside, dataset).to(device), fold=fold, split=split))
    _refuse_unlike(found, dataset)
    return found


def _baseline(name: str, beside: Sequence[Judged], dataset: Dataset) -> Dynamics:
    """A baseline; where the log records the steering angle, `kinematic` has the delay that a model beside it fitted."""
    if name == "ctrv":
        return ConstantMotion(vehicle_of(dataset))
    kinematic = Kinematic(vehicle_of(dataset))
    for model in beside:
        lags = getattr(model.dynamics, "actuators", None)
        if isinstance(lags, Actuators) and _channels(lags) == _channels(kinematic):
            kinematic.actuators.load_state_dict(lags.state_dict())
            break
    return kinematic


def _channels(model: Actuators | Kinematic) -> tuple[tuple[str, ...], ...]:
    return model.vehicle.control, model.vehicle.actuators


def _refuse_unlike(models: Sequence[Judged], dataset: Dataset) -> None:
    """Every model must be judged on the same windows, and every run once."""
    wanted = set(_splits(models, dataset))
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


def _splits(models: Sequence[Judged], dataset: Dataset) -> list[Split]:
    return list(dict.fromkeys(model.split or dataset.split for model in models)) or [dataset.split]


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


def _ways(dataset: Dataset, part: str, lookups: Sequence[Lookup], feature_sets: Sequence[str]) -> Sequence[Way]:
    """Where models can read the ground: features without a map only where they were recorded."""
    if not _has_ground(dataset):
        return (NO_WAY,)
    windows = Windows(dataset, part)
    mapped = not dataset.features or windows.maps.any
    sets = tuple(feature_sets) if windows.sets > 1 else (None,)
    recorded: list[Way] = [("recorded", chosen) for chosen in sets] if "recorded" in lookups or not mapped else []
    on_map: list[Way] = [("map", None)] if "map" in lookups and mapped else []
    return recorded + on_map


def _has_ground(dataset: Dataset) -> bool:
    """Whether there is anything to read from the ground."""
    return bool(dataset.features) or any(
        bool(np.nanmax(np.abs(drive.rows.normal[..., :2]), initial=0) > 0) for drive in dataset.drives
    )


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
