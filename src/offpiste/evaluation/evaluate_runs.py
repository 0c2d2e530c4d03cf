"""Evaluation of trained runs with a report: `offpiste evaluate`."""

import logging
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from offpiste.core.errors import OffpisteError, RunError, TooLarge
from offpiste.core.files import check_folder, unfinished
from offpiste.core.limits import parsed, read_small
from offpiste.core.shipped import named, run_folder
from offpiste.dataset.assumptions import assumptions_block, assumptions_of
from offpiste.dataset.log_findings import warning_line
from offpiste.dataset.split_balance import split_warning
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.evaluation.evaluate import EvaluatedModel, Evaluation, evaluate_models, named_apart
from offpiste.evaluation.intervals import MIN_UNITS, Levels
from offpiste.evaluation.metrics import Metrics, Start
from offpiste.evaluation.report import REPORT_FILES, UNFINISHED, terminal_table, write_report
from offpiste.training.checkpoint import fold_folders
from offpiste.training.prediction import Lookup
from offpiste.training.run import Run, differing_vehicle, load_run, refuse_seen, refuse_unfit

logger = logging.getLogger(__name__)

SLOWER = 0.2
"""Tolerated difference between the requested minimum speed and that of the slowest window with a map [m/s]."""


def evaluate_runs(
    folders: Sequence[Path],
    dataset_path: Path,
    out: Path,
    *,
    device: str = "cpu",
    starts: Sequence[Start] = ("causal", "smoothed"),
    lookups: Sequence[Lookup] = ("recorded", "map"),
    feature_sets: Sequence[str] = ("hindsight",),
    min_speed: float | None = None,
) -> Evaluation:
    """Evaluate runs on the test part of a dataset; write metrics.json, figures and report.html to `out`.

    Args:
        min_speed: smallest initial speed of a window [m/s]; 0 includes standstills; None: as in the dataset.

    Raises:
        RunError: no run is given, or one is unfinished, does not fit the dataset, or was trained on the test part.
        DatasetError: no such dataset, or no window in its test part.
        OffpisteError: `out` is a file or holds other files, or a setting is impossible.
    """
    if not folders:
        raise RunError("the runs are missing", how="name one or more: offpiste evaluate RUN... --dataset DATASET")
    check_folder(out, own=REPORT_FILES)
    if min_speed is not None and not 0 <= min_speed < math.inf:
        raise OffpisteError(f"invalid --min-speed {min_speed:g}", how="give a speed of 0 or more [m/s]")
    dataset = open_dataset(dataset_path).starting_above(min_speed)
    runs, models, given = list[Run](), list[EvaluatedModel](), list[Path]()
    for folder in folders:
        folds = fold_folders(run_folder(folder))
        for number, member in enumerate(folds or [folder]):
            run = load_run(member, device=device)
            fold, split = (number, parse_split(run.split)) if folds else (None, None)
            refuse_unfit(run, dataset)
            refuse_seen(run, dataset if split is None else dataset.relabelled(split), "test")
            runs.append(run)
            models.append(EvaluatedModel(run.model, run.dynamics, seed=run.seed, fold=fold, split=split))
            given.append(folder)
    models = named_apart(models, given)
    _refuse_unseen(runs, dataset)
    _warn_of_slow(dataset, min_speed)
    warnings = _warnings(runs, models, dataset)
    here = assumptions_of(dataset)
    warnings += sorted(
        {f"{run.model} was trained with: {each}" for run in runs for each in run.assumptions if each not in here}
    )
    evaluation = evaluate_models(
        models,
        dataset,
        scale=runs[0].scale,
        weights=runs[0].weights,
        starts=starts,
        lookups=lookups,
        feature_sets=feature_sets,
        warnings=warnings,
        device=device,
    )
    if (before := _other_report(out, evaluation.metrics)) is not None:
        logger.warning(f"replacing the report of {before} in {out}")
    with unfinished(out, UNFINISHED):
        write_report(evaluation, out)
    logger.info(terminal_table(evaluation.metrics.results).text())
    if {"recorded", "map"} <= {row.lookup for row in evaluation.metrics.results}:
        nearest = "" if dataset.features else ": without features, the slope of the nearest driven path"
        logger.info(f"Results with the lookup 'map' decide: they read the ground under the predicted wheels{nearest}.")
    levels = Levels(evaluation.metrics.windows.drives, evaluation.metrics.windows.blocks)
    if levels.caveat:
        whole = all(model.split is None for model in models) and all(d.snapshots is None for d in dataset.drives)
        more = " Train with --folds 5 to test on all of the driving." if whole and levels.units < MIN_UNITS else ""
        logger.info(levels.caveat + more)
    logger.info(assumptions_block(evaluation.metrics.assumptions))
    logger.info(f"report: {out / 'report.html'}")
    return evaluation


def _warnings(runs: Sequence[Run], models: Sequence[EvaluatedModel], dataset: Dataset) -> list[str]:
    """Log warnings about these models on this dataset; return those that are not stored in the dataset."""
    if (line := warning_line(dataset.findings)) is not None:
        logger.warning(line)
    apart = {named(run.folder): differing_vehicle(run.dynamics.vehicle, dataset.rig.vehicle) for run in runs}
    another = f"was trained on another vehicle than {dataset.rig.name}"
    warnings = [f"{name} {another}: {how}" for name, how in apart.items() if how is not None]
    trained_here = all(model.split is None for model in models) and {run.split for run in runs} == {dataset.split.text}
    if trained_here and (unlike := split_warning(dataset)) is not None:
        warnings.append(unlike)
    for warning in warnings:
        logger.warning(warning)
    return warnings


def _other_report(out: Path, metrics: Metrics) -> str | None:
    """Describe the existing report in a folder if it has other models or data."""
    try:
        there = parsed(read_small(out / "metrics.json"))
        dataset, models = there["dataset"], ", ".join(dict.fromkeys(row["model"] for row in there["results"]))
    except (OSError, TooLarge, ValueError, KeyError, TypeError):
        return None
    own = ", ".join(dict.fromkeys(row.model for row in metrics.results))
    return None if (dataset, models) == (metrics.dataset, own) else f"{models} on {dataset}"


def _warn_of_slow(dataset: Dataset, min_speed: float | None) -> None:
    """Warn if slow windows are requested and the dataset has no maps for them."""
    kept = [(drive.rows.state_causal[drive.snapshots.row]) for drive in dataset.drives if drive.snapshots is not None]
    state = np.concatenate(kept) if kept else np.zeros((0, 6))
    slowest = float(np.hypot(state[:, 3], state[:, 4]).min(initial=np.inf))
    if min_speed is not None and np.isfinite(slowest) and slowest > min_speed + SLOWER:
        logger.warning(
            f"only windows with a map are evaluated, above {slowest:.2g} m/s; "
            f"extract with --snapshot-speed {min_speed:g} for slower ones"
        )


def _refuse_unseen(runs: Sequence[Run], dataset: Dataset) -> None:
    """Check that the dataset has valid features if a model reads them."""
    reading = [run for run in runs if run.dynamics.encoder is not None]
    cells = [d.rows.cells for d in dataset.drives if d.rows.cells is not None]
    if reading and not any(bool(c.valid.any()) for c in cells):
        raise RunError(
            f"'{reading[0].model}' reads terrain features, and {dataset.path} has no valid ones",
            where=reading[0].folder,
            how="view the dataset with `offpiste view`, fix the rig's cameras and LiDARs and extract again",
        )
