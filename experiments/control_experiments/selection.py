"""Windows that the future leaves out: results on the map with them, without them, and on them alone.

Windows whose ground was hardly ever seen, also later, are left out (`offpiste.dataset.window_starts.MIN_HINDSIGHT`): a
planner cannot know which ones these are.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from experiments.control_experiments.reproduced import Reproduced
from experiments.control_experiments.tables import write_control
from offpiste.dataset.windows import Windows
from offpiste.errors import RunError
from offpiste.evaluation.errors import Errors
from offpiste.reproduction.gains import MAP, Gain, errors_of, evaluation_index, gain, gain_table

ABOUT = (
    "On the map at predicted places, baseline b. Usual windows have features in hindsight under at least the dataset's "
    "`min_hindsight` of their ground; the others are left out everywhere else."
)


def selection_control(of: Reproduced, out: Path) -> Path:
    """Evaluate the reproduction's runs on all windows that have a map, however little of their ground was ever seen.

    Raises:
        RunError: the dataset has no maps.
    """
    windows = Windows(replace(of.dataset, min_hindsight=0.0), "test")
    index = evaluation_index(windows, MAP, of.size.stride)
    every, folder, scale = np.arange(len(index)), out / "selection", of.scale
    if not windows.maps.any:
        raise RunError("has no map to evaluate on", where=of.dataset.path, how="give one with visual features")

    def found(model: str) -> list[Errors]:
        return [errors_of(run, windows, index, MAP, scale=scale, kept=folder / "evaluated") for run in of.runs(model)]

    errors = {model: found(model) for model in ["b", *of.present(("cf", "dc", "df"))]}
    usual = usual_windows(errors["b"][0], Windows(of.dataset, "test"))
    gains: list[Gain] = []
    cases = (("usual", every[usual]), ("all", every), ("left out", every[~usual]))
    for model in list(errors)[1:]:
        for case, chosen in cases:
            if not len(chosen):
                continue
            mine, base = ([e.take(chosen) for e in errors[name]] for name in (model, "b"))
            gains.append(gain(f"{case} windows", model, mine, base, MAP))
    left_out = int((~usual).sum())
    about = f"{ABOUT} Here that is {left_out} of {len(index)} windows."
    table = gain_table("Windows that the future leaves out", gains, about)
    results = {"control": "selection", "left_out": left_out, "min_hindsight": of.dataset.min_hindsight, "gains": gains}
    return write_control(folder, [table], results)


def usual_windows(errors: Errors, windows: Windows) -> Bool[np.ndarray, " n"]:
    """Whether the windows of some errors are among a dataset's windows, of the same drives."""
    index = np.arange(len(windows))
    return np.isin(errors.key, windows.drive[index].astype(np.int64) << 32 | windows.row_in_drive(index))
