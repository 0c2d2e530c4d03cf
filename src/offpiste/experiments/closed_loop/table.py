"""What planners did on the same courses: means, counts, and paired differences with their intervals."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from offpiste.files import write_text

MEASURES: Final = {
    "driven_cost": "driven cost",
    "time_s": "time [s]",
    "mean_path_error_m": "mean path error [m]",
    "worst_path_error_m": "worst path error [m]",
    "mean_speed_error_mps": "mean speed error [m/s]",
    "plan_error_5s_m": "plan's error after 5 s [m]",
}
RELATIVE: Final = ("driven_cost",)
"""Spread over orders of magnitude, so their logarithms are averaged: geometric means, and differences in percent."""

COUNTED: Final = {
    "finished": "finished",
    "rollover": "rolled over",
    "collision": "collided",
    "stuck": "stuck",
    "left_world": "left the world",
}
RESAMPLES: Final = 10_000


@dataclass(frozen=True)
class Difference:
    """Of a measure between two planners on the same courses: mean, and the 95 % interval bootstrapped over courses."""

    mean: float
    low: float
    high: float
    n: int


def paired(
    first: Float[np.ndarray, " n"], second: Float[np.ndarray, " n"], rng: np.random.Generator
) -> Difference | None:
    """First minus second over the courses where both are known; None with fewer than 3 of these."""
    both = np.isfinite(first) & np.isfinite(second)
    difference = (first - second)[both]
    if len(difference) < 3:
        return None
    draws = difference[rng.integers(len(difference), size=(RESAMPLES, len(difference)))].mean(axis=1)
    low, high = np.percentile(draws, (2.5, 97.5))
    return Difference(float(difference.mean()), float(low), float(high), len(difference))


def table(results: Sequence[dict[str, Any]], limit: float) -> str:
    """Markdown: every row's means and counts, and every row minus `parametric` and `b` at the same latency.

    Args:
        limit: of a drive's time: what did not finish counts with that [s].
    """
    rows = list(dict.fromkeys(r["row"] for r in results))
    courses = list(dict.fromkeys((r["world"], r["seed"]) for r in results))
    by = {(r["row"], r["world"], r["seed"]): r for r in results}
    values = {
        (row, key): np.array([_value(by.get((row, *course)), key, limit) for course in courses])
        for row in rows
        for key in MEASURES
    }
    lines = [
        f"{len(courses)} courses, means; a drive that does not finish counts with {limit:g} s, and standing until then."
        " Driven cost: what planners minimise, of what was driven (squared errors of path and speed, over time);"
        " geometric means, so that each course counts alike.",
        "",
    ]
    lines += [_line(["planner", *MEASURES.values(), *COUNTED.values()]), _rule(1 + len(MEASURES) + len(COUNTED))]
    for row in rows:
        mine = [r for r in results if r["row"] == row]
        cells = [_mean(values[row, key], key) for key in MEASURES]
        lines.append(_line([row, *cells, *(f"{sum(bool(r[key]) for r in mine)}" for key in COUNTED)]))
    lines += ["", "Paired differences on the same courses, with 95 % intervals bootstrapped over courses.", ""]
    lines += [_line(["difference", *MEASURES.values()]), _rule(1 + len(MEASURES))]
    for row in rows:
        for other in (o for o in rows if o != row and _compared(row, o)):
            found = {k: paired(values[row, k], values[other, k], np.random.default_rng(0)) for k in MEASURES}
            lines.append(_line([f"{row} − {other}", *(_interval(d, k) for k, d in found.items())]))
    return "\n".join(lines) + "\n"


def write_table(results: Sequence[dict[str, Any]], out: Path, limit: float) -> str:
    """Write table.md and results.json; returns the table."""
    text = table(results, limit)
    write_text(out / "table.md", text)
    kept = [{k: v for k, v in r.items() if k not in ("stages", "runtime")} for r in results]
    write_text(out / "results.json", json.dumps(kept, indent=1, allow_nan=False) + "\n")
    return text


def _compared(row: str, other: str) -> bool:
    """Baselines at the same latency, and itself at 100 ms."""
    (name, latency), (base, at) = row.rsplit("-", 1), other.rsplit("-", 1)
    order = ("parametric", "b", "dc", "ceiling")
    if name == base:
        return at == "100ms" and latency != at
    known = name in order and base in order
    return latency == at == "100ms" and (order.index(base) < order.index(name) if known else base in ("b",))


def _value(result: dict[str, Any] | None, key: str, limit: float) -> float:
    if result is None:
        return np.nan
    if key == "time_s" and not result["finished"]:
        return limit
    value = result[key]["mean"] if key == "plan_error_5s_m" else result[key]
    if value is None:
        return np.nan
    return float(np.log(value)) if key in RELATIVE else float(value)


def _mean(values: Float[np.ndarray, " n"], key: str) -> str:
    if not np.isfinite(values).any():
        return "–"
    mean = np.nanmean(values)
    return f"{np.exp(mean):.0f}" if key in RELATIVE else f"{mean:.2f}"


def _interval(d: Difference | None, key: str) -> str:
    if d is None:
        return "–"
    if key in RELATIVE:
        mean, low, high = (100 * np.expm1(value) for value in (d.mean, d.low, d.high))
        return f"{mean:+.0f} % [{low:+.0f}, {high:+.0f}]"
    return f"{d.mean:+.2f} [{d.low:+.2f}, {d.high:+.2f}]"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _rule(columns: int) -> str:
    return "|" + "---|" * columns
