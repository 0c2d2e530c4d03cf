"""Tables of models that read a recording's label against `b`, which does not."""

from collections.abc import Mapping, Sequence

import numpy as np

from offpiste.evaluation.errors import Errors, SeededErrors, by_seed
from offpiste.evaluation.intervals import Resampling, Sampling, relative

Results = Mapping[tuple[str, str, int], Errors]
"""Errors on the held-out recordings by label, model and seed; the same windows in each."""

_READ = {"floor": "the floor", "format": "the file format", "exchanged": "floor, evaluated with another floor's label"}
_VX = "vx_error_mps"


def tables(results: Results, drives: Sequence[str], floors: Mapping[str, int], names: Sequence[str]) -> str:
    """Markdown: against `b` over all windows, each false labelling by itself, and by recording.

    Args:
        drives: names of the recordings in the order of their numbers.
        floors, names: floor of each recording, and what floors are called.
    """
    blind = _seeds(results, "none", "b")
    drawn = Sampling().on(blind)
    lines = [
        f"{len(blind.row)} windows. Intervals are over recordings, blocks of 10 s and seeds: "
        f"{drawn.levels(len(blind.runs)).text()}.",
        "",
        "| model | label | 5 s error [m] | minus `b` | v_x at 5 s | loss |",
        "|---|---|---|---|---|---|",
        f"| `b` | none | {blind.distance().mean():.3f} | | {_vx(blind).mean():.3f} | {blind.loss.mean():.3f} |",
    ]
    models = list(dict.fromkeys(model for _, model, _ in results if model != "b"))
    for label, words in _READ.items():
        for model in models:
            lines.append(_row(f"| `{model}` | {words}", _seeds(results, label, model), blind, drawn))
    false = list(dict.fromkeys(label for label, _, _ in results if label.startswith("shuffled")))
    for model in models:
        both = [_against(results, label, model) for label in false]
        pooled = by_seed([mine for mine, _ in both], range(len(both)))
        lines.append(_row(f"| `{model}` | changed places ({len(false)})", pooled, blind, drawn))
    lines += ["", *_each(results, models, false), "", *_by_recording(results, models, blind, drives, floors, names)]
    return "\n".join(lines)


def _seeds(results: Results, label: str, model: str) -> SeededErrors:
    runs = {seed: errors for (result, name, seed), errors in results.items() if (result, name) == (label, model)}
    return by_seed(list(runs.values()), list(runs))


def _against(results: Results, label: str, model: str) -> tuple[Errors, Errors]:
    """A single run, and `b` of the same seed."""
    (seed,) = (s for result, name, s in results if (result, name) == (label, model))
    return results[label, model, seed], results["none", "b", seed]


def _row(begin: str, mine: SeededErrors, blind: SeededErrors, drawn: Resampling) -> str:
    result = relative(mine.distance(), blind.distance(), drawn)
    change = relative(mine.loss, blind.loss, drawn)
    return (
        f"{begin} | {mine.distance().mean():.3f} | {result.mean:+.1%} {_interval(result.ci95)} "
        f"| {_vx(mine).mean():.3f} | {mine.loss.mean():.3f} ({change.mean:+.0%} {_interval(change.ci95)}) |"
    )


def _each(results: Results, models: Sequence[str], false: Sequence[str]) -> list[str]:
    lines = []
    for model in models:
        gains = {}
        for label in false:
            mine, blind = _against(results, label, model)
            gains[label] = mine.distance().mean() / blind.distance().mean() - 1
        true = [
            results["floor", name, seed].distance().mean() / results["none", "b", seed].distance().mean() - 1
            for label, name, seed in results
            if (label, name) == ("floor", model)
        ]
        message = ", ".join(f"{gain:+.1%}" for gain in gains.values())
        lines.append(f"`{model}` minus `b` of the same seed: {', '.join(f'{g:+.1%}' for g in true)}; false: {message}.")
    return lines


def _by_recording(
    results: Results,
    models: Sequence[str],
    blind: SeededErrors,
    drives: Sequence[str],
    floors: Mapping[str, int],
    names: Sequence[str],
) -> list[str]:
    columns = {"b": blind, **{model: _seeds(results, "floor", model) for model in models}}
    lines = [
        "| recording | floor | windows | " + " | ".join(f"`{name}` [m]" for name in columns) + " |",
        "|---" * (3 + len(columns)) + "|",
    ]
    for number in np.unique(blind.drive).tolist():
        mine = blind.drive == number
        errors = " | ".join(f"{errors.distance()[:, mine].mean():.3f}" for errors in columns.values())
        lines.append(f"| {drives[number]} | {names[floors[drives[number]]]} | {mine.sum()} | {errors} |")
    return lines


def _interval(bounds: tuple[float, float]) -> str:
    low, high = (round(100 * bound) for bound in bounds)
    return f"[{low:+d}, {high:+d}]"


def _vx(errors: SeededErrors) -> np.ndarray:
    return errors.component(_VX)
