"""Many courses, several planners: a drive each, done once; then a table of differences on the same courses.

`python -m offpiste.experiments.closed_loop --help`. Goes on where it was stopped, from its folder.
"""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from offpiste.errors import RunError
from offpiste.experiments.closed_loop.drive_course import CourseDrive, drive_course
from offpiste.experiments.closed_loop.planner import Planner
from offpiste.files import write_text
from offpiste.simulation.build import make_world
from offpiste.simulation.world import World, WorldSettings

DEVELOPMENT, TEST = 1, 101
"""First seeds of the courses: everything is chosen on the first, and judged on the second."""

WORLDS: Final = ("mojave", "halter-ranch", "coastal-scrub", "dunes")
"""Course after course."""

MEASURES: Final = {
    "time_s": "time [s]",
    "mean_path_error_m": "mean path error [m]",
    "worst_path_error_m": "worst path error [m]",
    "mean_speed_error_mps": "mean speed error [m/s]",
    "plan_error_5s_m": "plan's error after 5 s [m]",
}
COUNTED: Final = {
    "finished": "finished",
    "rollover": "rolled over",
    "collision": "collided",
    "stuck": "stuck",
    "left_world": "left the world",
}
RESAMPLES: Final = 10_000


@dataclass(frozen=True)
class Entry:
    """A planner at a latency [s]."""

    planner: Planner
    latency: float = 0.1

    @property
    def name(self) -> str:
        """What a row and a folder are called."""
        return f"{self.planner.name}-{round(1000 * self.latency)}ms"


def entries(planners: Sequence[Planner], latencies: Sequence[float] = (0.0, 0.3)) -> list[Entry]:
    """All at 0.1 s; those that know the ground ahead at other latencies too."""
    wide = [Entry(p, latency) for p in planners if p.name in ("dc", "ceiling") for latency in latencies]
    return [*(Entry(p) for p in planners), *wide]


def drive_all(
    rows: Sequence[Entry],
    seeds: Sequence[int],
    out: Path,
    asked: CourseDrive | None = None,
    *,
    tell: Callable[[object], None] = lambda said: None,
) -> list[dict[str, Any]]:
    """Drive what is not driven yet, course by course; returns all results.

    Raises:
        RunError: the folder holds drives of other settings or runs.
    """
    asked, results = asked or CourseDrive(), []
    for number, seed in enumerate(seeds):
        place = WorldSettings(WORLDS[number % len(WORLDS)], seed)
        world: World | None = None
        for row in rows:
            folder = out / row.name / f"{place.preset}-{seed}"
            found = _read(folder / "result.json")
            if found is None:
                shutil.rmtree(folder, ignore_errors=True)  # an interrupted drive
                world = world or make_world(place)
                drive = replace(asked, world=place, runtime=replace(asked.runtime, latency=row.latency))
                found = drive_course(row.planner, drive, folder, world=world, tell=tell).result
            if found["run"] != str(row.planner.folder.resolve()) or found["target_mps"] != asked.course.speed:
                raise RunError("a drive of another run or course", where=folder, how="give another --out")
            results.append({**found, "row": row.name})
    return results


def _read(path: Path) -> dict[str, Any] | None:
    return json.loads(path.read_text("utf-8")) if path.exists() else None


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
    lines = [f"{len(courses)} courses, means; a drive that does not finish counts with {limit:g} s.", ""]
    lines += [_line(["planner", *MEASURES.values(), *COUNTED.values()]), _rule(1 + len(MEASURES) + len(COUNTED))]
    for row in rows:
        mine = [r for r in results if r["row"] == row]
        cells = [_mean(values[row, key]) for key in MEASURES]
        lines.append(_line([row, *cells, *(f"{sum(bool(r[key]) for r in mine)}" for key in COUNTED)]))
    lines += ["", "Paired differences on the same courses, with 95 % intervals bootstrapped over courses.", ""]
    lines += [_line(["difference", *MEASURES.values()]), _rule(1 + len(MEASURES))]
    for row in rows:
        for other in (o for o in rows if o != row and _compared(row, o)):
            found = [paired(values[row, k], values[other, k], np.random.default_rng(0)) for k in MEASURES]
            lines.append(_line([f"{row} − {other}", *(_interval(d) for d in found)]))
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
    return np.nan if value is None else float(value)


def _mean(values: Float[np.ndarray, " n"]) -> str:
    return f"{np.nanmean(values):.2f}" if np.isfinite(values).any() else "–"


def _interval(d: Difference | None) -> str:
    return "–" if d is None else f"{d.mean:+.2f} [{d.low:+.2f}, {d.high:+.2f}]"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _rule(columns: int) -> str:
    return "|" + "---|" * columns
