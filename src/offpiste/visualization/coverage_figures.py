"""Figures of what a dataset's visual features cover: rates, distances, differences."""

from collections.abc import Callable, Collection
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure

from offpiste.core.conventions import FEATURE_SETS
from offpiste.dataset.feature_coverage import PAPER_DIFFERENCE, PAPER_RATES
from offpiste.dataset.feature_sets import DISTANCES, TOLERANCE
from offpiste.report.figure import BLUE, GREEN, GRID, INK, ORANGE, PURPLE, SOFT, plain, png
from offpiste.report.page import Picture, Section, table_section
from offpiste.visualization.coverage_tables import FeatureCoverage, tables

PLACES = np.arange(len(FEATURE_SETS))
TICKS = [name if name == "hindsight" else f"{name} m" for name in FEATURE_SETS]


def draw_rates(coverage: FeatureCoverage) -> Figure:
    """Valid rates by distance, of each drive, of all, and the paper's."""
    figure = Figure(figsize=(8.4, 4.4), dpi=130, layout="constrained")
    axes = plain(figure.subplots(), f"Valid features by distance, {coverage.whole.cells} cells")
    for number, drive in enumerate(coverage.drives if len(coverage.drives) > 1 else ()):
        axes.plot(PLACES, drive.share, color=SOFT, linewidth=0.8, label="" if number else "each drive")
    axes.plot(PLACES, coverage.whole.share, "o-", color=BLUE, label="all cells")
    axes.plot(PLACES, coverage.whole.in_reach, "o--", color=GREEN, label="cells within reach of the distance")
    axes.plot(PLACES, PAPER_RATES, "s:", color=ORANGE, label="paper")
    axes.set(ylim=(0, 1.05), ylabel="share of valid cells")
    axes.set_xticks(PLACES, TICKS)
    axes.legend(frameon=False, fontsize=8, loc="lower left")
    return figure


def draw_distances(coverage: FeatureCoverage) -> Figure:
    """Distances that features were observed from, against the distance of each feature set."""
    figure = Figure(figsize=(8.4, 4.0), dpi=130, layout="constrained")
    axes = plain(figure.subplots(), "Distance from sensor to ground when valid features were observed")
    low, middle, high = coverage.quartiles.T
    wanted = PLACES[1:][DISTANCES >= 0]
    axes.bar(
        wanted, 2 * TOLERANCE, 0.8, DISTANCES[DISTANCES >= 0] - TOLERANCE, color=GRID, label="of the set: vehicle ± 5 m"
    )
    axes.vlines(PLACES, low, high, color=BLUE, linewidth=5, alpha=0.5, label="quartiles")
    axes.plot(PLACES, middle, "o", color=BLUE, label="median")
    axes.set(ylabel="distance [m]", ylim=(0, None))
    axes.set_xticks(PLACES, TICKS)
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    return figure


def draw_differences(coverage: FeatureCoverage) -> Figure:
    """L2 differences between sets as a matrix, and of each feature between distances next to each other."""
    figure = Figure(figsize=(11.5, 4.8), dpi=130, layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
    length = coverage.apart.length
    image = left.imshow(length, cmap="viridis", vmin=0)
    for row in PLACES:
        for column in PLACES:
            value = length[row, column]
            bright = np.isfinite(value) and value > 0.6 * np.nanmax(length)
            text = f"{value:.2f}" if np.isfinite(value) else "–"
            left.text(column, row, text, ha="center", va="center", fontsize=8, color=INK if bright else "white")
    left.set_xticks(PLACES, TICKS, rotation=45)
    left.set_yticks(PLACES, TICKS)
    left.set_title("Mean l2 difference, of the features' range", loc="left", fontsize=10)
    figure.colorbar(image, ax=left, shrink=0.85)

    plain(right, "Each feature between neighbouring distances, of its range")
    for differences, colour, name in ((coverage.apart, BLUE, "1 to 99 %"), (coverage.apart_of_total, PURPLE, "total")):
        steps = np.arange(len(differences.neighbours()))
        shift = -0.13 if colour == BLUE else 0.13
        for number, values in enumerate(differences.neighbours()):
            at = np.full(len(values), number + shift)
            right.plot(at, values, ".", color=colour, markersize=5, alpha=0.4, label="" if number else f"range {name}")
    right.axhline(PAPER_DIFFERENCE, color=ORANGE, linestyle=":", label="paper: 30 %")
    right.set_xticks(steps, [f"{a} / {b}" for a, b in pairwise(FEATURE_SETS[1:])])
    right.set(xlabel="distances [m]", ylabel="mean absolute difference / range", ylim=(0, None))
    right.legend(frameon=False, fontsize=8)
    return figure


FIGURES: dict[str, tuple[str, Callable[[FeatureCoverage], Figure], str]] = {
    "rates": ("Valid rates", draw_rates, "Valid rates by distance; negative distances lie behind the vehicle."),
    "distances": (
        "Achieved observation distances",
        draw_distances,
        "Achieved observation distances; grey: how far the vehicle was from the cell.",
    ),
    "differences": (
        "Differences between sets",
        draw_differences,
        "Left: between all sets. Right: a dot per feature, between distances next to each other.",
    ),
}
"""Title of the table that a figure stands below, the function that draws it, and its caption."""


def coverage_sections(coverage: FeatureCoverage, figures: Collection[str] = tuple(FIGURES)) -> list[Section]:
    """All tables as sections of a page, with these figures below them."""
    sections = []
    for table in tables(coverage):
        drawn = [(name, *FIGURES[name][1:]) for name in figures if FIGURES[name][0] == table.title]
        sections.append(
            table_section(table, *(Picture(name, png(draw(coverage)), caption) for name, draw, caption in drawn))
        )
    return sections
