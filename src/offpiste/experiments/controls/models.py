"""Other models beside `b` and `dc`: what looking ahead, physics, parameters, history and drawn sets are worth."""

from collections.abc import Callable
from pathlib import Path

from offpiste.dataset.windows import Windows
from offpiste.evaluation.judge import Errors
from offpiste.evaluation.ways import Way
from offpiste.experiments.controls.judging import HINDSIGHT, MAP, errors_of, gain, judged_index
from offpiste.experiments.controls.reproduced import Reproduced
from offpiste.experiments.controls.training import trained
from offpiste.experiments.controls.written import gain_table, write_control

FEATURED = {
    "dc-hold": "dc with the features of the window's start held: what looking ahead adds",
    "dc-step": "a set drawn at every step, not once a trajectory",
    "cf-masked": "hindsight, masked as a drawn distance would be: does distance matter, or only what is missing",
}
BLIND = {
    "lstm": "no physics",
    "b-wide": "b with as many parameters as dc",
    "b-history": "b with a stronger reading of the last 0.2 s",
}
ABOUT = (
    "Relative to the baseline on the same windows, 95 % intervals over blocks of 10 s; windows x runs that are "
    "averaged (one run of the control models). Map: as it was at the window's start, read at predicted places. "
)


def models_control(of: Reproduced, out: Path, models: list[str], *, tell: Callable[[str], None]) -> Path:
    """Train one run each of the control models as the reproduction trains its own, and judge all on its windows.

    Args:
        models: of `FEATURED` and `BLIND`; all where empty.
    """
    chosen = models or [*FEATURED, *BLIND]
    windows = Windows(of.dataset, "test")
    folder, scale = out / "models", of.scale
    present = of.present(("b", "cf", "dc"))
    runs = {model: of.runs(model) for model in present}
    for model in chosen:
        config = of.member(model).config(of.size, 0, "cpu")
        runs[model] = [trained(of.dataset, config, folder / "runs", stages=of.folder / "runs", tell=tell)]
    ways: list[Way] = [MAP, HINDSIGHT] + [("recorded", name) for name in ("10", "20", "30", "40")]
    errors: dict[tuple[str, Way], list[Errors]] = {}
    for way in ways:
        index = judged_index(windows, way, of.size.stride)
        for model in runs:
            if way in (MAP, HINDSIGHT) or model not in BLIND:
                errors[model, way] = [
                    errors_of(run, windows, index, way, scale=scale, kept=out / "judged") for run in runs[model]
                ]
    over_b = [
        gain(FEATURED.get(model, BLIND.get(model, "")), model, found, errors["b", way], way)
        for (model, way), found in errors.items()
        if model != "b"
    ]
    over_dc = [
        gain("", model, found, errors["dc", way], way, baseline="dc")
        for (model, way), found in errors.items()
        if "dc" in runs and model not in ("b", "cf", "dc")
    ]
    tables = [gain_table("Control models against b", over_b, ABOUT + "Baseline: b.")]
    if over_dc:
        tables.append(gain_table("Control models against dc", over_dc, ABOUT + "Baseline: dc; above 0: worse."))
    return write_control(folder, tables, {"control": "models", "against_b": over_b, "against_dc": over_dc})
