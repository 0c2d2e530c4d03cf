"""What planners did on the same courses: means, counts, and paired differences with their intervals."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from offpiste.evaluation.intervals import MIN_UNITS, resampling
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
BOTH_FINISH: Final = "driven cost where both finish (courses)"
ORDER: Final = ("parametric", "b", "dc", "ceiling")
"""Each knows more than those before."""

RESAMPLES: Final = 10_000

Drive = dict[str, Any] | None
"""What result.json holds, and its row; None: not driven."""

Drives = Mapping[str, Sequence[Drive]]
"""Of every row, course after course."""


@dataclass(frozen=True)
class Difference:
    """Of a measure between two planners on the same courses: mean, and the 95 % interval bootstrapped over courses."""

    mean: float
    low: float
    high: float
    n: int


def paired(first: Float[np.ndarray, " n"], second: Float[np.ndarray, " n"], seed: int = 0) -> Difference | None:
    """First minus second over the courses where both are known; None with too few of these."""
    both = np.isfinite(first) & np.isfinite(second)
    difference = (first - second)[both]
    if len(difference) < MIN_UNITS:
        return None
    # Each course has a world of its own, and is one block.
    course = np.arange(len(difference))
    drawn = resampling(course, course, seed, resamples=RESAMPLES)
    return Difference(float(difference.mean()), *drawn.interval(drawn.means(difference)), len(difference))


def table(results: Sequence[dict[str, Any]], limit: float) -> str:
    """Markdown: every row's means and counts, and paired differences between rows.

    Args:
        limit: of a drive's time: what did not finish counts with that [s].
    """
    rows = list(dict.fromkeys(r["row"] for r in results))
    courses = list(dict.fromkeys((r["world"], r["seed"]) for r in results))
    by = {(r["row"], r["world"], r["seed"]): r for r in results}
    drives = {row: [by.get((row, *course)) for course in courses] for row in rows}
    return "\n".join([*_means(drives, limit), "", *_differences(drives, limit)]) + "\n"


def _means(drives: Drives, limit: float) -> list[str]:
    """A line for every planner."""
    lines = [
        f"{len(next(iter(drives.values())))} courses, means. A drive that does not finish counts with {limit:g} s, and"
        " in its driven cost as standing on its course until then; errors are of what was driven. Driven cost: the"
        " terms of path and speed of what planners minimise (squared errors, over time), of what was driven; geometric"
        " means, so that each course counts alike.",
        "",
        _line(["planner", *MEASURES.values(), *COUNTED.values()]),
        _rule(1 + len(MEASURES) + len(COUNTED)),
    ]
    for row, driven in drives.items():
        means = [_mean(_values(driven, key, limit), key) for key in MEASURES]
        lines.append(_line([row, *means, *(f"{sum(bool(r and r[key]) for r in driven)}" for key in COUNTED)]))
    return lines


def _differences(drives: Drives, limit: float) -> list[str]:
    """A line for every two planners that are compared."""
    lines = [
        "Paired differences on the same courses, with 95 % intervals bootstrapped over courses. The last column leaves"
        " out courses that not both finish, and so shows how they drive, not how often they stop.",
        "",
        _line(["difference", *MEASURES.values(), BOTH_FINISH]),
        _rule(2 + len(MEASURES)),
    ]
    for row in drives:
        for other in (o for o in drives if o != row and _compared(row, o)):
            found = {key: _paired(drives[row], drives[other], key, limit) for key in MEASURES}
            both = [
                pair for pair in zip(drives[row], drives[other], strict=True) if all(r and r["finished"] for r in pair)
            ]
            cost = _paired([pair[0] for pair in both], [pair[1] for pair in both], "driven_cost", limit)
            cells = [_interval(d, key) for key, d in found.items()]
            lines.append(_line([f"{row} − {other}", *cells, f"{_interval(cost, 'driven_cost')} ({len(both)})"]))
    return lines


def _paired(first: Sequence[Drive], second: Sequence[Drive], key: str, limit: float) -> Difference | None:
    return paired(_values(first, key, limit), _values(second, key, limit))


def write_table(results: Sequence[dict[str, Any]], out: Path, limit: float) -> str:
    """Write table.md and results.json; returns the table."""
    text = table(results, limit)
    write_text(out / "table.md", text)
    kept = [{k: v for k, v in r.items() if k not in ("stages", "runtime")} for r in results]
    write_text(out / "results.json", json.dumps(kept, indent=1, allow_nan=False) + "\n")
    return text


def _compared(row: str, other: str) -> bool:
    """With those that know less at the same latency, and with itself at 100 ms."""
    (name, latency), (base, at) = row.rsplit("-", 1), other.rsplit("-", 1)
    if name == base:
        return at == "100ms" and latency != at
    known = name in ORDER and base in ORDER
    return latency == at and (ORDER.index(base) < ORDER.index(name) if known else base == "b")


def _values(driven: Sequence[Drive], key: str, limit: float) -> Float[np.ndarray, " n"]:
    return np.array([_value(drive, key, limit) for drive in driven])


def _value(result: Drive, key: str, limit: float) -> float:
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
