"""Where the rest lies: which part of `b`'s error `dc` takes away, which one better eyes would, and what then is left.

Each bar is one way of reading the ground. From bottom to top: what is left where the true ground is known, split by how
well the start is known; what features do not tell, or tell from near only; and what `dc` gains already.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from matplotlib.figure import Figure

from experiments.control_experiments.data import true_ground
from experiments.control_experiments.models import trained_seeds
from experiments.control_experiments.reproduced import Reproduced
from experiments.control_experiments.tables import write_control
from offpiste.dataset.windows import Windows
from offpiste.evaluation.errors import Errors
from offpiste.evaluation.evaluated_models import Reading
from offpiste.report.text_table import TextTable, number
from offpiste.reproduction.gains import HINDSIGHT, MAP, errors_of, evaluation_index, runs_of, same_windows

ABOUT: Final = (
    "In percent of the distance error after 5 s of the `b` that reads the same normals. Gained: by `dc`. Distance: "
    "what `dc` gains more in hindsight. Features: what the oracle gains more than `dc` in hindsight; on the map, where "
    "there is no hindsight, more than `dc`, distance included. Start: what the oracle gains more from starts as they "
    "are known afterwards. Rest: what is left even so: model, amount of driving, and what no map holds."
)
READINGS: Final[tuple[Reading, ...]] = (*(("recorded", name) for name in ("10", "20", "30", "40")), MAP)
PARTS: Final = {
    "rest": "#555555",
    "start": "#aaaaaa",
    "features": "#d9a441",
    "distance": "#efd9a7",
    "gained": "#7b3fa0",
}


class Bar(msgspec.Struct, frozen=True, kw_only=True):
    """Shares of `b`'s error, which add up to 1; a negative one is a loss.

    Attributes:
        lookup: how the ground is read.
        error_m: of `b` [m].
    """

    lookup: str
    error_m: float
    rest: float
    start: float
    features: float
    distance: float
    gained: float


def gap_control(of: Reproduced, out: Path, seeds: int) -> Path:
    """Compare `dc` with itself in hindsight, with the oracle, and with the oracle from the best known starts."""
    folder, scale = out / "oracle", of.scale
    truth = true_ground(of, folder)
    config = replace(of.size.train, seed=0)
    knowing = {m: trained_seeds(truth, replace(config, model=m), folder / "runs", seeds) for m in ("b", "df")}
    windows, true_windows = Windows(of.dataset, "test"), Windows(truth, "test")
    known_starts = Windows(truth, "test", start="smoothed")

    def seen(model: str, reading: Reading, index: np.ndarray) -> float:
        kept = out / "evaluated"
        runs = of.runs(model)[:seeds]
        return _mean([errors_of(run, windows, index, reading, scale=scale, kept=kept) for run in runs])

    def true(model: str, reading: Reading, index: np.ndarray, *, starts: str = "oracle") -> float:
        kept, among = out / "evaluated" / starts, true_windows if starts == "oracle" else known_starts
        return _mean([errors_of(run, among, index, reading, scale=scale, kept=kept) for run in knowing[model]])

    bars = []
    for reading in READINGS:
        index = evaluation_index(windows, reading, of.size.stride)
        there, of_truth = same_windows(windows, index, true_windows), MAP if reading == MAP else HINDSIGHT
        blind, base = seen("b", reading, index), true("b", of_truth, there)
        gained = 1 - seen("dc", reading, index) / blind
        hindsight = gained if reading == MAP else 1 - seen("dc", HINDSIGHT, index) / seen("b", HINDSIGHT, index)
        oracle = 1 - true("df", of_truth, there) / base
        best = 1 - true("df", of_truth, there, starts="known starts") / base
        bars.append(
            Bar(
                lookup="map" if reading == MAP else f"{reading[1]} m",
                error_m=blind,
                rest=1 - best,
                start=best - oracle,
                features=oracle - hindsight,
                distance=hindsight - gained,
                gained=gained,
            )
        )
    table = TextTable(
        "Where the rest lies",
        ("lookup", "b [m]", *(f"{part} [%]" for part in PARTS)),
        tuple((bar.lookup, number(bar.error_m), *(number(100 * share, 1) for share in _shares(bar))) for bar in bars),
        ABOUT,
    )
    return write_control(out / "gap", [table], {"control": "gap", "bars": bars}, {"gap": draw_gap(bars)})


def _mean(errors: Sequence[Errors]) -> float:
    return float(runs_of(errors).distance().mean())


def _shares(bar: Bar) -> list[float]:
    return [getattr(bar, part) for part in PARTS]


def draw_gap(bars: list[Bar]) -> Figure:
    """A stacked bar for each lookup, with the percentages in it."""
    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    axes = figure.subplots()
    for place, bar in enumerate(bars):
        foot = 0.0
        for (part, colour), value in zip(PARTS.items(), _shares(bar), strict=True):
            share = max(100 * value, 0.0)
            axes.bar(place, share, 0.7, bottom=foot, color=colour, label=part if place == 0 else None)
            if share >= 3:
                dark = part in ("rest", "gained")
                axes.annotate(
                    f"{share:.0f}",
                    (place, foot + share / 2),
                    ha="center",
                    va="center",
                    color="white" if dark else "black",
                )
            foot += share
    axes.set_xticks(range(len(bars)), [bar.lookup for bar in bars])
    axes.set(ylabel="distance error after 5 s [% of b's]", xlabel="ground as seen from, or on the map at the start")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], frameon=False, loc="outside right center")
    return figure
