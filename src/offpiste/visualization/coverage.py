"""Coverage of a dataset's visual features: valid rates, observation distances, differences between sets."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import FEATURE_SETS
from offpiste.dataset import feature_coverage
from offpiste.dataset.feature_coverage import HINDSIGHT, PAPER_RATES
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dataset.wheel_passes import Passes, find_passes
from offpiste.mapping.terrain_map import wheel_positions
from offpiste.mapping.voxel_map import VoxelSettings
from offpiste.report.chart import Chart, Line, Panel
from offpiste.report.figure import BLUE, GREEN, ORANGE, SOFT
from offpiste.report.page import Section, picture, table_section
from offpiste.report.text_table import TextTable, number
from offpiste.rig.rig import Rig

STRIDE = 5
"""Number of rows between the vehicle positions that decide on reach: 0.1 s."""

Rates = Float[np.ndarray, " D"]


@dataclass(frozen=True)
class FeatureCoverage:
    """Coverage of a dataset's visual features, by feature set.

    Attributes:
        cells: number of cells, each counted once per pass.
        share: valid share of all cells.
        of_hindsight: valid share of the cells that are valid in hindsight, as in the paper's table.
        in_reach: valid share of the cells that the vehicle passed at the set's distance; NaN if unknown.
        by_drive: valid share of all cells, by drive.
        quartiles: quartiles of the observation distances [m].
        apart: differences between sets, relative to the features' ranges between the 1st and the 99th percentile.
        apart_of_total: the same relative to the total range of values, as in the paper.
        unrelated: difference of unrelated cells, as in `apart.length`.
    """

    cells: int
    share: Rates
    of_hindsight: Rates
    in_reach: Rates
    by_drive: dict[str, Rates]
    quartiles: Float[np.ndarray, "D 3"]
    apart: feature_coverage.Differences
    apart_of_total: feature_coverage.Differences
    unrelated: float


def measure_coverage(dataset: Dataset) -> FeatureCoverage | None:
    """Measure the coverage of a dataset's features; None if no drive has features by distance."""
    drives = [(drive, drive.rows.cells) for drive in dataset.drives]
    chosen = [(drive, own) for drive, own in drives if own is not None and _by_distance(own)]
    cells = [own for _, own in chosen]
    if not sum(c.valid.shape[1] for c in cells):
        return None
    reached = [_reached(drive, passes_of(drive, dataset.rig), own) for drive, own in chosen]
    span, total = feature_coverage.feature_range(cells), feature_coverage.feature_range(cells, (0.0, 100.0))
    return FeatureCoverage(
        cells=sum(c.valid.shape[1] for c in cells),
        share=feature_coverage.valid_rates(cells),
        of_hindsight=feature_coverage.valid_rates(cells, feature_coverage.in_hindsight(cells)),
        in_reach=feature_coverage.valid_rates(cells, reached),
        by_drive={drive.name: feature_coverage.valid_rates([own]) for drive, own in chosen},
        quartiles=feature_coverage.observation_quartiles(cells),
        apart=feature_coverage.differences(cells, span),
        apart_of_total=feature_coverage.differences(cells, total),
        unrelated=feature_coverage.unrelated(cells, span, np.random.default_rng(0)),
    )


def _by_distance(cells: Cells) -> bool:
    """Whether cells have visual features of all feature sets."""
    return len(cells.valid) == len(FEATURE_SETS) and cells.features.shape[2] > 0


def passes_of(drive: StoredDrive, rig: Rig) -> Passes | None:
    """Return the passes of a drive's cells; None if they were not made with the usual map."""
    rows, xy = drive.rows, drive.rows.world_xy
    wheels = wheel_positions(xy, rows.state[:, 2].astype(np.float64), rig.wheel_positions())
    passes = find_passes(rows.time, xy, wheels, resolution=VoxelSettings().size)
    same = rows.cells is not None and np.array_equal(passes.index, rows.cells.index)
    return passes if same else None


def _reached(drive: StoredDrive, passes: Passes | None, cells: Cells) -> np.ndarray:
    if passes is None:
        return np.zeros_like(cells.valid)
    time, xy = drive.rows.time[::STRIDE], drive.rows.world_xy[::STRIDE]
    return feature_coverage.within_reach(passes, time, xy, VoxelSettings().size)


def tables(coverage: FeatureCoverage) -> tuple[TextTable, ...]:
    """Return all tables in reading order."""
    shares: dict[str, Sequence[float] | Rates] = {
        f"all ({coverage.cells} cells)": coverage.share,
        "  of those valid in hindsight": coverage.of_hindsight,
        "  of those within reach": coverage.in_reach,
        **(coverage.by_drive if len(coverage.by_drive) > 1 else {}),
        "paper": PAPER_RATES,
    }
    rates = _by_set(
        "Valid rates",
        "valid rate by distance [m]",
        shares.items(),
        "Share of cells under the wheels with features, each counted once per pass. Within reach: only cells that "
        "the vehicle passed at the set's distance, ± 5 m; the start of a drive was never seen from 40 m.",
    )
    distances = _by_set(
        "Achieved observation distances",
        "observation distance [m]",
        zip(("25 %", "median", "75 %"), coverage.quartiles.T, strict=True),
        "Distance from the sensor to the ground at the observation of the features. The map keeps the closest "
        "observation: ground behind the vehicle was seen just before it was driven over, unless a camera looks back.",
        digits=1,
    )
    matrix = _by_set(
        "Differences between sets",
        "l2 difference / range",
        zip(FEATURE_SETS, coverage.apart.length, strict=True),
        "Mean l2 norm of the difference of the same cells' features between two sets, if both are valid, divided by "
        "the l2 norm of the features' ranges (1st to 99th percentile of all cells in hindsight). Unrelated cells "
        f"differ by {number(coverage.unrelated)}.",
    )
    return rates, distances, matrix, _neighbours(coverage)


def _by_set(
    title: str, name: str, lines: Iterable[tuple[str, Sequence[float] | Rates]], about: str, digits: int = 2
) -> TextTable:
    """Return a table with a column per feature set."""
    text = [(line, *(number(value, digits) for value in values)) for line, values in lines]
    return TextTable(title, (name, *FEATURE_SETS), text, about)


def _neighbours(coverage: FeatureCoverage) -> TextTable:
    lines = []
    for name, differences in (("1 to 99 %", coverage.apart), ("total", coverage.apart_of_total)):
        each = differences.neighbours()
        known = np.isfinite(each).any(axis=1)
        for what, reduce in (("mean", np.nanmean), ("largest", np.nanmax)):
            values = np.full(len(each), np.nan)
            if known.any():
                values[known] = reduce(each[known], axis=1)
            lines.append((f"{what} of all features, range {name}", *(number(v) for v in values)))
    about = (
        "Mean absolute difference of each feature between neighbouring distances, divided by the feature's range. "
        "The paper finds 0.3 of the total range of values."
    )
    names = ("difference / range", *(f"{a}/{b}" for a, b in pairwise(FEATURE_SETS[1:])))
    return TextTable("Differences of single features", names, lines, about)


def headline(coverage: FeatureCoverage) -> str:
    """Return a sentence with the main numbers."""
    rates = ", ".join(f"{name} {number(rate)}" for name, rate in zip(FEATURE_SETS, coverage.share, strict=True))
    far = coverage.apart.length[HINDSIGHT]
    most = number(np.nanmax(far)) if np.isfinite(far).any() else "–"
    return f"valid by distance: {rates}; features differ from those in hindsight by up to {most} of their range"


def rates_chart(coverage: FeatureCoverage) -> Chart:
    """Describe valid rates by distance, of each drive, of all, and of the paper."""
    drives = coverage.by_drive.values() if len(coverage.by_drive) > 1 else ()
    lines = [_line("each drive", rates, SOFT, width=0.8) for rates in drives]
    lines += [
        _line("all cells", coverage.share, BLUE, marker="o"),
        _line("cells within reach of the distance", coverage.in_reach, GREEN, style="--", marker="o"),
        _line("paper", np.array(PAPER_RATES), ORANGE, style=":", marker="^"),
    ]
    panel = Panel("feature set", "share of valid cells", lines, y_range=(0.0, 1.05), x_ticks=FEATURE_SETS)
    return Chart([panel], f"Valid features by distance [m], {coverage.cells} cells")


def distances_chart(coverage: FeatureCoverage) -> Chart:
    """Describe the median observation distance of each feature set, with the quartiles as a band."""
    low, middle, high = coverage.quartiles.T
    line = _line("median; band: quartiles", middle, BLUE, marker="o", low=low, high=high)
    panel = Panel("feature set", "distance from sensor to ground [m]", [line], x_ticks=FEATURE_SETS)
    return Chart([panel], "Observation of valid features")


def _line(label: str, values: Rates, colour: str, **look: Any) -> Line:
    return Line(label, np.arange(float(len(values))), values, colour, **look)


def coverage_sections(coverage: FeatureCoverage) -> list[Section]:
    """Return all tables as sections of a page, with figures below the first two."""
    rates, distances, *others = tables(coverage)
    by_rates = "Valid rates by distance; negative distances lie behind the vehicle."
    by_distances = "Achieved observation distances by the distance of the feature set."
    return [
        table_section(rates, picture("rates", rates_chart(coverage), by_rates)),
        table_section(distances, picture("distances", distances_chart(coverage), by_distances)),
        *map(table_section, others),
    ]
