"""What models make of a vehicle at a standstill: where it is after 3 s, and whether it moves at all.

By the kind of ground under the wheels, which the simulator knows, and by the slope along the vehicle; on the map as it
was, at predicted places. A vehicle that is held by its brake tells nothing, so windows whose throttle stays shut are
counted apart.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from experiments.control_experiments.data import true_ground
from experiments.control_experiments.reproduced import Reproduced
from experiments.control_experiments.tables import write_control
from experiments.novelty import kinds_of
from offpiste.conventions import CONTROL, DT
from offpiste.dataset.windows import Batch, Windows
from offpiste.errors import DatasetError
from offpiste.evaluation.errors import trajectories
from offpiste.evaluation.evaluated_windows import EvaluatedWindows
from offpiste.evaluation.intervals import Sampling, summary
from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.report.text_table import TextTable, interval, number
from offpiste.reproduction.gains import MAP, evaluation_index, same_windows
from offpiste.runtime.backing_out import BackingOutSettings
from offpiste.training.run import load_run

AT_REST: Final = 0.1
"""Speed below which a window starts at a standstill [m/s]."""

AFTER: Final = 3.0
"""Time after which places are compared [s]."""

MOVED: Final = BackingOutSettings().moved
"""Distance from which a vehicle has moved [m], as the run time counts."""

OPEN: Final = 0.05
"""Mean throttle over that time from which a window is driven."""

STEEP: Final = 5.0
"""Slope along the vehicle from which ground is not level [degrees]."""

MIXED: Final = "mixed"

ABOUT: Final = (
    f"Windows that start below {AT_REST} m/s, on the map; after {AFTER:g} s. Moves: share of vehicles that are more "
    f"than {MOVED} m away; to say so always is right in as many. Right: share of windows in which the model is, "
    f"with 95 % intervals over drives and blocks of 10 s where there are enough. Throttle shut: below {OPEN} in the "
    "mean; in all other rows it is open. At the best limit: the most that any distance which separates moving from "
    "staying makes right, chosen on these windows for each run. Up and down: more than "
    f"{STEEP:g} degrees along the vehicle. The oracle: df on the true ground, where that experiment was run in the "
    "same folder."
)


def standstill_control(of: Reproduced, out: Path) -> Path:
    """Compare the reproduction's models on windows that start at a standstill.

    Raises:
        DatasetError: no window with a snapshot does.
    """
    windows = Windows(of.dataset, "test", min_speed=0.0)
    index = at_rest(windows, evaluation_index(windows, MAP, of.size.stride))
    batch, step = windows.gather(index), round(AFTER / DT) - 1
    truth = Windows(true_ground(of, out / "oracle"), "test", min_speed=0.0)
    driven = (batch.target[:, step, :2] - batch.state[:, :2]).numpy()
    moves = _far(driven)
    there = same_windows(windows, index, truth)
    groups = grouped(batch, kinds_under_wheels(truth, there), step, moves)
    sampled = {
        name: Sampling().on(EvaluatedWindows(of.dataset, windows.drive[chosen], windows.row_in_drive(chosen)))
        for name, chosen in ((name, index[among]) for name, among in groups.items())
    }
    rows: list[dict[str, Any]] = [
        {"group": name, "n": int(among.sum()), "moves": float(moves[among].mean()), "models": {}}
        for name, among in groups.items()
    ]
    readers = {model: (of.runs(model), windows, index) for model in of.present(("parametric", "b", "dc"))}
    if knowing := [load_run(done.parent) for done in sorted((out / "oracle" / "runs").glob("df-*/model.json"))]:
        readers["oracle"] = knowing, truth, there
    for model, (runs, read, at) in readers.items():
        predicted = [trajectories(run.dynamics, read, at, lookup="map")[:, step, :2] for run in runs]
        missed = np.mean([np.linalg.norm(each - driven, axis=-1) for each in predicted], axis=0)
        right = np.mean([_far(each) == moves for each in predicted], axis=0)
        at_best = [
            np.mean([right_at_best(each[among], moves[among]) for each in predicted]) for among in groups.values()
        ]
        for row, best, (name, among) in zip(rows, at_best, groups.items(), strict=True):
            of_right = summary(right[among], sampled[name])
            row["models"][model] = {
                "error_m": float(missed[among].mean()),
                "right": of_right.mean,
                "right_ci95": of_right.ci95,
                "right_at_best": float(best),
            }
    table = standstill_table(rows, list(readers))
    return write_control(out / "standstill", [table], {"control": "standstill", "rows": rows})


def _far(moved: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
    return np.asarray(np.linalg.norm(moved, axis=-1) > MOVED)


def right_at_best(predicted: Float[np.ndarray, "n 2"], moves: Bool[np.ndarray, " n"]) -> float:
    """Share that is right at the best of all limits of moving: no choice of `MOVED` makes it more."""
    moves = moves[np.argsort(np.linalg.norm(predicted, axis=-1))]
    stays_below = np.concatenate(([0], np.cumsum(~moves)))
    moves_above = moves.sum() - np.concatenate(([0], np.cumsum(moves)))
    return float((stays_below + moves_above).max() / len(moves))


def at_rest(windows: Windows, index: Int[np.ndarray, " n"]) -> Int[np.ndarray, " m"]:
    """Those of some windows that start at a standstill.

    Raises:
        DatasetError: none does.
    """
    start = windows.gather(index).state
    found = index[np.asarray(start[:, 3:5].norm(dim=-1) < AT_REST)]
    if not len(found):
        how = "extract it with `--snapshot-speed 0`"
        raise DatasetError("no window with a snapshot starts at a standstill", where=windows.dataset.path, how=how)
    return found


def kinds_under_wheels(truth: Windows, index: Int[np.ndarray, " n"]) -> list[str]:
    """The kind of ground under all four wheels at the start of windows, or `MIXED`.

    Args:
        truth: windows of the same drives, with the true ground properties as features.

    Raises:
        DatasetError: they have none.
    """
    ground = truth.gather(index).ground
    if ground is None:
        raise DatasetError("has no true ground", where=truth.dataset.path, how="extract it with ground-truth features")
    cells = ground.ahead[:, 0]  # [n, 4]
    kind = kinds_of(ground.features[cells.flatten()].double().numpy()).reshape(cells.shape)
    alike = (kind == kind[:, :1]).all(axis=1) & (kind[:, 0] >= 0)
    return [GROUND_KINDS[first] if same else MIXED for first, same in zip(kind[:, 0], alike, strict=True)]


def grouped(
    batch: Batch, kinds: list[str], step: int, moves: Bool[np.ndarray, " n"]
) -> dict[str, Bool[np.ndarray, " n"]]:
    """Windows with an open throttle, by what came of it, ground and slope; and those whose throttle stays shut.

    Args:
        kinds: of ground under each window's start.
        step: last step [`conventions.DT`] of the time over which the throttle is averaged.
        moves: which vehicles did.
    """
    throttle = batch.control[:, : step + 1, CONTROL.index("throttle")].mean(dim=1).numpy()
    is_open, slope, kind = throttle >= OPEN, slope_along(batch), np.array(kinds)
    groups = {"all": is_open, "that move": is_open & moves, "that stay": is_open & ~moves}
    groups |= {name: is_open & (kind == name) for name in (*GROUND_KINDS, MIXED)}
    groups |= {
        "down": is_open & (slope < -STEEP),
        "level": is_open & (abs(slope) <= STEEP),
        "up": is_open & (slope > STEEP),
        "throttle shut": ~is_open,
    }
    return {name: among for name, among in groups.items() if among.any()}


def slope_along(batch: Batch) -> Float[np.ndarray, " n"]:
    """Slope of the ground ahead of windows' starts, up above 0, by the mean normal under the wheels [degrees]."""
    normal, yaw = batch.terrain.normal[:, 0].mean(dim=1), batch.state[:, 2]
    ahead = normal[:, 0] * yaw.cos() + normal[:, 1] * yaw.sin()
    return np.asarray(torch.rad2deg(torch.atan2(-ahead, normal[:, 2])))


def standstill_table(rows: list[dict[str, Any]], models: list[str]) -> TextTable:
    """A line a group, with error and share of right answers of each model."""
    of_models = (f"{model}: {what}" for model in models for what in ("[m]", "right [%]"))
    names = ("ground", "windows", "moves [%]", *of_models)
    lines = [
        (
            row["group"],
            f"{row['n']}",
            number(100 * row["moves"], 0),
            *(text for model in models for text in _written(row["models"][model])),
        )
        for row in rows
    ]
    at_best = (text for model in models for text in ("", number(100 * rows[0]["models"][model]["right_at_best"], 0)))
    lines.insert(1, (f"{rows[0]['group']}, at the best limit", "", "", *at_best))
    return TextTable("From a standstill", names, tuple(lines), ABOUT)


def _written(found: dict[str, Any]) -> tuple[str, str]:
    """Error, and share of right answers with its interval."""
    low, high = (100 * bound for bound in found["right_ci95"])
    return number(found["error_m"]), f"{number(100 * found['right'], 0)} {interval((low, high), 0)}"
