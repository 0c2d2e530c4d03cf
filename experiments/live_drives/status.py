"""The table of `live --status`: numbers of each process over time."""

import csv
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from offpiste.core.errors import LiveError

NUMBERS: Final = ("cpu_s", "rss_mb", "tick_p99_ms", "map_age_p99_ms", "plan_age_p99_ms", "plan_ms", "map_ms", "dropped")
"""Columns that are read; NaN where a process has none."""

SETTLED: Final = 300.0
"""Memory counts from so long after the start on [s]: until then maps and windows fill."""


class Part(NamedTuple):
    """One process: times [s], `NUMBERS` by column, and its states in words."""

    time: Float[np.ndarray, " n"]
    numbers: dict[str, Float[np.ndarray, " n"]]
    states: tuple[str, ...]

    def worst(self, name: str) -> float:
        """The largest of some numbers while the vehicle is driven; NaN where it is not."""
        driven = [state.startswith(("driving", "degraded")) for state in self.states]
        numbers = self.numbers[name][driven]
        return float(np.nanmax(numbers)) if np.isfinite(numbers).any() else float("nan")

    def share_of_core(self) -> float:
        """Processor time over the clock's, while it was there; restarts begin anew."""
        spent = np.diff(self.numbers["cpu_s"])
        return float(spent[spent > 0].sum() / max(self.time[-1] - self.time[0], 1e-9))

    def growth(self) -> float:
        """Slope of its memory once it has settled [MB/h]; NaN where it was not there for so long."""
        late = (self.time > self.time[0] + SETTLED) & np.isfinite(self.numbers["rss_mb"])
        if late.sum() < 2:
            return float("nan")
        return float(3600 * np.polyfit(self.time[late], self.numbers["rss_mb"][late], 1)[0])


def read_status(path: Path) -> dict[str, Part]:
    """The processes of a drive by name.

    Raises:
        LiveError: there is no such table, or nothing in it.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except OSError as error:
        raise LiveError("no table of how processes were", where=path, how="see what live said beside it") from error
    if not rows:
        raise LiveError("nothing in it: live did not come to drive", where=path, how="see what live said beside it")
    parts = {}
    for name in dict.fromkeys(row["part"] for row in rows):
        own = [row for row in rows if row["part"] == name]
        numbers = {key: np.array([float(row[key] or "nan") for row in own]) for key in NUMBERS}
        states = tuple(row["state"] for row in own)
        parts[name] = Part(np.array([float(row["time"]) for row in own]), numbers, states)
    return parts


def draw(parts: dict[str, Part]) -> Figure:
    """Memory of each process, and how late control, maps and plans are, over time."""
    figure = Figure(figsize=(8.0, 5.6), layout="constrained")
    memory, late = figure.subplots(2, 1, sharex=True)
    begin = min(part.time[0] for part in parts.values())
    for name, part in parts.items():
        memory.plot((part.time - begin) / 60, part.numbers["rss_mb"], label=name, linewidth=1)
    for name, key, label in (
        ("control", "tick_p99_ms", "tick of control, late by, p99"),
        ("control", "map_age_p99_ms", "age of the map, p99"),
        ("control", "plan_age_p99_ms", "age of the plan, p99"),
        ("plan", "plan_ms", "a plan takes"),
        ("map", "map_ms", "a scan into the map takes"),
    ):
        if name in parts and np.isfinite(parts[name].numbers[key]).any():
            late.plot((parts[name].time - begin) / 60, parts[name].numbers[key], label=label, linewidth=1)
    memory.set(ylabel="memory [MB]", ylim=(0, None))
    late.set(xlabel="time [min]", ylabel="[ms]", yscale="log")
    for axes in (memory, late):
        axes.grid(color="#e5e5e5", linewidth=0.5)
        axes.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
