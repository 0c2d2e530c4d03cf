"""Table of planners on the same courses: means, counts, and paired differences with their intervals."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from offpiste.core.files import write_text
from offpiste.evaluation.intervals import MIN_UNITS, PairedDifference, resampling

MEASURES: Final = {
    "driven_cost": "driven cost",
    "moving_cost": "driven cost behind the run-up",
    "time_s": "time [s]",
    "mean_path_error_m": "mean path error [m]",
    "worst_path_error_m": "worst path error [m]",
    "mean_speed_error_mps": "mean speed error [m/s]",
    "plan_error_5s_m": "plan's error after 5 s [m]",
    "energy_kj": "energy where it finishes [kJ]",
    "interventions": "interventions",
}
RELATIVE: Final = ("driven_cost", "moving_cost")
"""Measures that spread over orders of magnitude: geometric means, and differences in percent."""

COUNTED: Final = {
    "finished": "finished",
    "rollover": "rolled over",
    "collision": "collided",
    "damage": "damaged",
    "stuck": "stuck",
    "left_world": "left the world",
    "backed_out": "backed out",
}
FREED: Final = "and finished"
"""Column of the drives that backed out and finished."""
BOTH_FINISH: Final = {
    "driven_cost": "driven cost where both finish (pairs)",
    "moving_cost": "behind the run-up where both finish",
}
ORDER: Final = ("parametric", "b", "cf", "dc", "ceiling")
"""Models by how much they know of the ground, the least first."""

RESAMPLES: Final = 10_000

Drive = dict[str, Any] | None
"""Content of result.json, with the row; None: not driven."""

Runs = Sequence[Sequence[Drive]]
"""Drives of the runs of some seeds, course after course."""

Drives = Mapping[str, Mapping[int, Sequence[Drive]]]
"""Drives of every row, by the seed of the run that drove, course after course."""


def paired(first: Float[np.ndarray, "S n"], second: Float[np.ndarray, "S n"]) -> PairedDifference | None:
    """Return first minus second where both are known, with the interval over courses and seeds.

    Args:
        first, second: of each run, in the same order of seeds, and course.

    Returns:
        None on too few courses.
    """
    difference = first - second
    difference = difference[:, np.isfinite(difference).any(axis=0)]
    if difference.shape[1] < MIN_UNITS:
        return None
    # Each course has a world of its own, and is one block.
    course = np.arange(difference.shape[1])
    drawn = resampling(course, course, 0, resamples=RESAMPLES)
    seeds, known = drawn.seed_draws(len(difference)), np.isfinite(difference)
    sums = ((seeds @ np.nan_to_num(difference)) * drawn.draws).sum(axis=1)
    with np.errstate(invalid="ignore"):
        means = sums / ((seeds @ known) * drawn.draws).sum(axis=1)
    return PairedDifference(float(difference[known].mean()), drawn.interval(means))


def table(results: Sequence[dict[str, Any]], limit: float) -> str:
    """Return Markdown: means and counts of every row, and paired differences between rows; also by kind of course.

    Args:
        limit: time limit of a drive, with which an unfinished drive counts [s].
    """
    kinds = list(dict.fromkeys(r["course"]["kind"] for r in results))
    parts = [("All courses", list(results))] if len(kinds) > 1 else []
    parts += [(kind.capitalize(), [r for r in results if r["course"]["kind"] == kind]) for kind in kinds]
    lines = _commits(results)
    lines += [line for title, of_kind in parts for line in (f"## {title}", "", *_part(of_kind, limit), "")]
    return "\n".join(lines[:-1]) + "\n"


def _commits(results: Sequence[dict[str, Any]]) -> list[str]:
    """Return a warning if the compared drives come from different commits."""
    if len({r["commit"] for r in results}) < 2:
        return []
    by = {r["row"]: sorted({o["commit"] or "unknown" for o in results if o["row"] == r["row"]}) for r in results}
    rows = "; ".join(f"{row}: {', '.join(commits)}" for row, commits in by.items())
    return [f"**Drives of several commits**, so that differences are of the code as well: {rows}.", ""]


def _part(results: Sequence[dict[str, Any]], limit: float) -> list[str]:
    drives = by_row(results)
    choices = any(r["firm_way"] is not None for r in results)
    firm = ["", *_firm_ways(drives)] if choices else []
    return [*_means(drives, limit), *firm, "", *_differences(drives, limit)]


def _firm_ways(drives: Drives) -> list[str]:
    """Describe how often each planner took the firm one of two ways, and paired differences of these shares."""
    against: dict[str, list[str]] = {row: [] for row in drives}
    for row, other, mine, its in _pairs(drives):
        if (found := paired(_firm(mine), _firm(its))) is not None:
            mean, low, high = (100 * value for value in (found.mean, *found.ci95))
            against[row].append(f"− {other}: {mean:+.0f} [{low:+.0f}, {high:+.0f}]")
    rows = []
    for row, runs in drives.items():
        taken = _firm(list(runs.values()))
        known = np.isfinite(taken)
        share = f"{100 * np.nanmean(taken):.0f} %" if known.any() else "–"
        rows.append([row, f"{int(np.nansum(taken))} of {known.sum()}", share, "; ".join(against[row]) or "–"])
    about = "The firm one of two ways, of the drives that got to their middle; differences in percentage points."
    return [about, "", *_markdown(["planner", "firm way", "share", "difference"], rows)]


def _firm(runs: Runs) -> Float[np.ndarray, "S n"]:
    """Return 1 where the firm way was taken, 0 where the other, NaN where neither is known."""
    return _array(runs, itemgetter("firm_way"))


def by_row(results: Sequence[dict[str, Any]]) -> Drives:
    """Return results by row, seed of the run, and course."""
    rows = list(dict.fromkeys(r["row"] for r in results))
    courses = list(dict.fromkeys((r["world"], r["seed"]) for r in results))
    seeds = {row: list(dict.fromkeys(r["run_seed"] for r in results if r["row"] == row)) for row in rows}
    by = {(r["row"], r["run_seed"], r["world"], r["seed"]): r for r in results}
    return {row: {s: [by.get((row, s, *course)) for course in courses] for s in seeds[row]} for row in rows}


def driven_cost_against(drives: Drives, row: str, base: str, limit: float) -> PairedDifference | None:
    """Return the driven cost of a row relative to another's on the same courses (-0.1: 10 % below); None on too few."""
    mine, its = _paired_runs(drives[row], drives[base])
    found = paired(_values(mine, "driven_cost", limit), _values(its, "driven_cost", limit)) if mine else None
    if found is None:
        return None
    mean, low, high = (float(np.expm1(value)) for value in (found.mean, *found.ci95))
    return PairedDifference(mean, (low, high))


def _means(drives: Drives, limit: float) -> list[str]:
    """Return a line for every planner."""
    about = (
        f"{_courses(drives)} courses; means over them and the runs of all seeds. A drive that does not finish counts"
        f" with {limit:g} s, and in its driven cost as standing where it ended until then; errors are of what was"
        " driven. Driven cost: the terms of path and speed of what planners minimise (squared errors, over time), of"
        " what was driven; geometric means, so that each course counts alike. Interventions: stops by the run time"
        " while it drove, and each rollover, collision, being stuck and leaving the world. Damaged: rolled over or"
        " collided. Stuck: gave up, or was not free when its time was up. Backed out: once or more; the last column"
        " counts those of them that finished."
    )
    lines = []
    for row, runs in drives.items():
        means = [_mean(_values(list(runs.values()), key, limit), key) for key in MEASURES]
        driven = [drive for courses in runs.values() for drive in courses if drive]
        counts = [str(sum(bool(drive[key]) for drive in driven)) for key in COUNTED]
        counts.append(str(sum(bool(drive["backed_out"] and drive["finished"]) for drive in driven)))
        lines.append([row, str(len(runs)), *means, str(len(driven)), *counts])
    return [about, "", *_markdown(["planner", "runs", *MEASURES.values(), "drives", *COUNTED.values(), FREED], lines)]


def _courses(drives: Drives) -> int:
    return len(next(iter(next(iter(drives.values())).values())))


def _differences(drives: Drives, limit: float) -> list[str]:
    """Return a line for every two planners that are compared."""
    about = (
        "Paired differences on the same courses between runs of the same seeds, or the only runs that there are, with"
        f" 95 % intervals bootstrapped over courses and seeds; –: fewer than {MIN_UNITS} courses. The last two leave"
        " out drives that not both finish, and so show how they drive, not how often they stop."
    )
    rows = [[f"{row} − {other}", *_compare(mine, its, limit)] for row, other, mine, its in _pairs(drives)]
    return [about, "", *_markdown(["difference", *MEASURES.values(), *BOTH_FINISH.values()], rows)]


def _pairs(drives: Drives) -> Iterator[tuple[str, str, Runs, Runs]]:
    """Yield the rows that are compared, with their runs that are paired."""
    for row in drives:
        for other in (o for o in drives if o != row and _compared(row, o)):
            mine, its = _paired_runs(drives[row], drives[other])
            if mine:
                yield row, other, mine, its


def _paired_runs(mine: Mapping[int, Sequence[Drive]], its: Mapping[int, Sequence[Drive]]) -> tuple[Runs, Runs]:
    """Return the runs of the seeds that both have; if each has a single run, those."""
    if len(mine) == len(its) == 1:
        return list(mine.values()), list(its.values())
    seeds = [seed for seed in mine if seed in its]
    return [mine[seed] for seed in seeds], [its[seed] for seed in seeds]


def _compare(mine: Runs, its: Runs, limit: float) -> list[str]:
    """Return the cells of a line: a difference for each measure, and those of the costs where both finish."""
    found = {key: paired(_values(mine, key, limit), _values(its, key, limit)) for key in MEASURES}
    finish = (_array(mine, itemgetter("finished")) == 1) & (_array(its, itemgetter("finished")) == 1)
    cells = [_interval(difference, key) for key, difference in found.items()]
    for key in BOTH_FINISH:
        one, other = (np.where(finish, _values(runs, key, limit), np.nan) for runs in (mine, its))
        pairs = f" ({finish.sum()})" if key == "driven_cost" else ""
        cells.append(f"{_interval(paired(one, other), key)}{pairs}")
    return cells


def write_table(results: Sequence[dict[str, Any]], out: Path, limit: float) -> str:
    """Write table.md and results.json; return the table."""
    text = table(results, limit)
    write_text(out / "table.md", text)
    kept = [{k: v for k, v in r.items() if k not in ("stages", "runtime")} for r in results]
    write_text(out / "results.json", json.dumps(kept, indent=1, allow_nan=False) + "\n")
    return text


def _compared(row: str, other: str) -> bool:
    """Return whether a row is compared with another: those that know less at its latency, and itself at 100 ms.

    A row with a risk or another planner is compared with the same model without, with `b`, and with those that know
    less and have the same.
    """
    (name, latency), (base, at) = row.rsplit("-", 1), other.rsplit("-", 1)
    if name == base:
        return at == "100ms" and latency != at
    (model, _, more), (other_model, _, others_more) = name.partition("+"), base.partition("+")
    if more != others_more:
        return latency == at and not others_more and base in (model, "b")
    known = model in ORDER and other_model in ORDER
    return latency == at and (ORDER.index(other_model) < ORDER.index(model) if known else other_model == "b")


def _array(runs: Runs, read: Callable[[dict[str, Any]], Any]) -> Float[np.ndarray, "S n"]:
    """Return a number of each drive; NaN where a course was not driven or the number is None."""
    return np.array([[None if drive is None else read(drive) for drive in courses] for courses in runs], float)


def _values(runs: Runs, key: str, limit: float) -> Float[np.ndarray, "S n"]:
    """Return a measure of each drive, of `RELATIVE` ones the logarithm."""

    def value(result: dict[str, Any]) -> float | None:
        if key == "time_s" and not result["finished"]:
            return limit
        if key == "energy_kj" and not result["finished"]:
            return None
        return result["plan_error_5s_m"]["mean"] if key == "plan_error_5s_m" else result[key]

    values = _array(runs, value)
    return np.log(values) if key in RELATIVE else values


def _mean(values: Float[np.ndarray, "S n"], key: str) -> str:
    if not np.isfinite(values).any():
        return "–"
    mean = np.nanmean(values)
    return f"{np.exp(mean):.0f}" if key in RELATIVE else f"{mean:.2f}"


def _interval(difference: PairedDifference | None, key: str) -> str:
    if difference is None:
        return "–"
    values = np.array((difference.mean, *difference.ci95))
    if key in RELATIVE:
        mean, low, high = 100 * np.expm1(values)
        return f"{mean:+.0f} % [{low:+.0f}, {high:+.0f}]"
    mean, low, high = values
    return f"{mean:+.2f} [{low:+.2f}, {high:+.2f}]"


def _markdown(names: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table."""
    head, *lines = (f"| {' | '.join(cells)} |" for cells in (names, *rows))
    return [head, "|" + "---|" * len(names), *lines]
