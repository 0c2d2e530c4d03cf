"""What `dc` gains over `b` by the speed at the start, by kind of world, by distance, and for each seed."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int

from experiments.control_experiments.reproduced import Reproduced
from experiments.gains import Gain, gain, gain_table, write_control
from offpiste.dataset.windows import Windows
from offpiste.evaluation.errors import Errors, load_errors, save_errors
from offpiste.evaluation.evaluate import Reading
from offpiste.evaluation.evaluated_windows import EvaluatedWindows, members
from offpiste.reproduction.results import HINDSIGHT, MAP
from offpiste.reproduction.runs import errors_of_runs, errors_path, evaluation_windows

ABOUT = "Baseline b; below 0: better than b. By speed, world and seed: on the map as it was, read at predicted places."
READINGS: tuple[Reading, ...] = (MAP, *(("recorded", name) for name in ("10", "20", "30")), HINDSIGHT)


def strata_control(of: Reproduced, out: Path) -> Path:
    """Compare the reproduction's runs of `dc` and `b`; errors that they lack are kept beside them."""
    windows, gains = Windows(of.dataset, "test"), list[Gain]()
    for reading in READINGS:
        index = evaluation_windows(windows, reading, of.size.stride)
        errors = _errors(of, ("b", "dc"), windows, index, reading)
        gains.append(gain("", "dc", errors["dc"], errors["b"], reading))
        if reading != MAP:
            continue
        for name, among in strata(windows, index).items():
            mine, base = ([each.take(np.flatnonzero(among)) for each in errors[model]] for model in ("dc", "b"))
            gains.append(gain(name, "dc", mine, base, reading))
        for seed, (one, other) in enumerate(zip(errors["dc"], errors["b"], strict=True)):
            gains.append(gain(f"seed {seed}", "dc", [one], [other], reading))
    return write_control(out / "strata", [gain_table("Strata", gains, ABOUT)], {"control": "strata", "gains": gains})


def strata(windows: Windows, index: Int[np.ndarray, " n"]) -> dict[str, Bool[np.ndarray, " n"]]:
    """Which of some windows start in each band of speed or in reverse, and in each kind of world (in drives' names)."""
    bands = members(EvaluatedWindows(windows.dataset, windows.drive[index], windows.row_in_drive(index)))
    world = np.array([windows.drive_names[drive].rsplit("-", 1)[0] for drive in windows.drive[index]])
    return bands | {str(name): world == name for name in np.unique(world)}


def _errors(
    of: Reproduced, models: Sequence[str], windows: Windows, index: Int[np.ndarray, " n"], reading: Reading
) -> Mapping[str, list[Errors]]:
    """Errors of all runs of some models, in the order of their seeds; runs that lack them read the maps together."""
    runs = {model: of.runs(model) for model in models}
    lacking = [run for each in runs.values() for run in each if not errors_path(run.folder, reading).exists()]
    if lacking:
        found = errors_of_runs(lacking, windows, index, reading, scale=of.scale)
        for run, errors in zip(lacking, found, strict=True):
            save_errors(errors_path(run.folder, reading), errors)
    return {model: [load_errors(errors_path(run.folder, reading)) for run in each] for model, each in runs.items()}
