"""Coverage of a dataset's visual features: valid rates, observation distances, differences between sets."""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int
from matplotlib.figure import Figure

from offpiste.core.conventions import FEATURE_SETS
from offpiste.dataset import feature_coverage
from offpiste.dataset.feature_coverage import HINDSIGHT, PAPER_DIFFERENCE, PAPER_RATES
from offpiste.dataset.feature_sets import DISTANCES, TOLERANCE
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dataset.wheel_passes import Passes, find_passes
from offpiste.mapping.terrain_map import wheel_positions
from offpiste.mapping.voxel_map import VoxelSettings
from offpiste.report.figure import BLUE, GREEN, GRID, INK, ORANGE, PURPLE, SOFT, plain
from offpiste.report.page import Section, picture, table_section
from offpiste.report.text_table import TextTable, number
from offpiste.rig.rig import Rig

STRIDE = 5
"""Number of rows between the vehicle positions that decide on reach: 0.1 s."""
PLACES = np.arange(len(FEATURE_SETS))
TICKS = [name if name == "hindsight" else f"{name} m" for name in FEATURE_SETS]


@dataclass(frozen=True)
class Rates:
    """Valid rates by feature set, of one drive or of all.

    Attributes:
        name: of the drive.
        cells: number of cells, each counted once per pass.
        share: valid share of all cells.
        of_hindsight: valid share of the cells that are valid in hindsight, as in the paper's table.
        in_reach: valid share of the cells that the vehicle passed at the set's distance; NaN if unknown.
    """

    name: str
    cells: int
    share: Float[np.ndarray, " D"]
    of_hindsight: Float[np.ndarray, " D"]
    in_reach: Float[np.ndarray, " D"]


@dataclass(frozen=True)
class FeatureCoverage:
    """Coverage of a dataset's visual features.

    Attributes:
        drives: valid rates of each drive with such features.
        whole: valid rates of all drives together.
        quartiles: quartiles of the observation distances [m].
        apart: differences between sets, relative to the features' ranges between the 1st and the 99th percentile.
        apart_of_total: the same relative to the total range of values, as in the paper.
        unrelated: difference of unrelated cells, as in `apart.length`.
        contacts: contacts of wheels with cells, by number of earlier passes over the place; empty if unknown.
    """

    drives: tuple[Rates, ...]
    whole: Rates
    quartiles: Float[np.ndarray, "D 3"]
    apart: feature_coverage.Differences
    apart_of_total: feature_coverage.Differences
    unrelated: float
    contacts: Int[np.ndarray, " K"]


def measure_coverage(dataset: Dataset, *, seed: int = 0) -> FeatureCoverage | None:
    """Measure the coverage of a dataset's features; None if no drive has features by distance.

    Args:
        seed: of the random pairs of unrelated cells.
    """
    result = [(drive, drive.rows.cells) for drive in dataset.drives if _by_distance(drive.rows.cells)]
    cells = [c for _, c in result if c is not None]
    if not sum(c.valid.shape[1] for c in cells):
        return None
    passes = [passes_of(drive, dataset.rig) for drive, _ in result]
    reached = [_reached(drive, p) for (drive, _), p in zip(result, passes, strict=True)]
    drives = [_rates(d.name, [c], [r]) for (d, _), c, r in zip(result, cells, reached, strict=True)]
    span, total = feature_coverage.feature_range(cells), feature_coverage.feature_range(cells, (0.0, 100.0))
    counts = [feature_coverage.contacts_by_pass(p) for p in passes if p is not None]
    contacts = np.zeros(max((len(c) for c in counts), default=0), np.int64)
    for count in counts:
        contacts[: len(count)] += count
    return FeatureCoverage(
        tuple(drives),
        _rates("all", cells, reached),
        feature_coverage.observation_quartiles(cells),
        feature_coverage.differences(cells, span),
        feature_coverage.differences(cells, total),
        feature_coverage.unrelated(cells, span, np.random.default_rng(seed)),
        contacts if all(p is not None for p in passes) else contacts[:0],
    )


def _by_distance(cells: Cells | None) -> bool:
    """Whether cells have visual features of all feature sets."""
    return cells is not None and len(cells.valid) == len(FEATURE_SETS) and cells.features.shape[2] > 0


def passes_of(drive: StoredDrive, rig: Rig) -> Passes | None:
    """Return the passes of a drive's cells; None if they were not made with the usual map."""
    rows = drive.rows
    xy = drive.rows.world_xy
    wheels = wheel_positions(xy, rows.state[:, 2].astype(np.float64), rig.wheel_positions())
    passes = find_passes(rows.time, xy, wheels, resolution=VoxelSettings().size)
    same = rows.cells is not None and np.array_equal(passes.index, rows.cells.index)
    return passes if same else None


def _reached(drive: StoredDrive, passes: Passes | None) -> np.ndarray:
    if passes is None:
        assert drive.rows.cells is not None
        return np.zeros_like(drive.rows.cells.valid)
    time, xy = drive.rows.time[::STRIDE], drive.rows.world_xy[::STRIDE]
    return feature_coverage.within_reach(passes, time, xy, VoxelSettings().size)


def _rates(name: str, cells: Sequence[Cells], reached: Sequence[np.ndarray]) -> Rates:
    return Rates(
        name,
        sum(c.valid.shape[1] for c in cells),
        feature_coverage.valid_rates(cells),
        feature_coverage.valid_rates(cells, feature_coverage.in_hindsight(cells)),
        feature_coverage.valid_rates(cells, reached),
    )


def tables(coverage: FeatureCoverage) -> tuple[TextTable, ...]:
    """Return all tables in reading order."""
    counted = (_contacts(coverage),) if len(coverage.contacts) else ()
    return (_rate_table(coverage), _distances(coverage), _matrix(coverage), _neighbours(coverage), *counted)


def _rate_table(coverage: FeatureCoverage) -> TextTable:
    rows: list[tuple[str, Iterable[float]]] = []
    for rates in (*(coverage.drives if len(coverage.drives) > 1 else ()), coverage.whole):
        rows += [
            (f"{rates.name} ({rates.cells} cells)", rates.share),
            ("  of those valid in hindsight", rates.of_hindsight),
            ("  of those within reach", rates.in_reach),
        ]
    lines = tuple((name, *map(number, shares)) for name, shares in (*rows, ("paper", PAPER_RATES)))
    about = (
        "Share of cells under the wheels with features, each counted once per pass. Within reach: only cells that "
        "the vehicle passed at the set's distance, ± 5 m; the start of a drive was never seen from 40 m."
    )
    return TextTable("Valid rates", ("valid rate by distance [m]", *FEATURE_SETS), lines, about)


def _distances(coverage: FeatureCoverage) -> TextTable:
    lines = [
        (name, *(number(value, 1) for value in column))
        for name, column in zip(("25 %", "median", "75 %"), coverage.quartiles.T, strict=True)
    ]
    about = (
        "Distance from the sensor to the ground at the observation of the features. The map keeps the closest "
        "observation: ground behind the vehicle was seen just before it was driven over, unless a camera looks back."
    )
    names = ("observation distance [m]", *FEATURE_SETS)
    return TextTable("Achieved observation distances", names, tuple(lines), about)


def _matrix(coverage: FeatureCoverage) -> TextTable:
    length = coverage.apart.length
    lines = [(name, *(number(v) for v in row)) for name, row in zip(FEATURE_SETS, length, strict=True)]
    about = (
        "Mean l2 norm of the difference of the same cells' features between two sets, if both are valid, divided by "
        "the l2 norm of the features' ranges (1st to 99th percentile of all cells in hindsight). Unrelated cells "
        f"differ by {number(coverage.unrelated)}."
    )
    return TextTable("Differences between sets", ("l2 difference / range", *FEATURE_SETS), tuple(lines), about)


def _neighbours(coverage: FeatureCoverage) -> TextTable:
    pairs = [f"{a}/{b}" for a, b in pairwise(FEATURE_SETS[1:])]
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
    return TextTable("Differences of single features", ("difference / range", *pairs), tuple(lines), about)


def _contacts(coverage: FeatureCoverage) -> TextTable:
    share = coverage.contacts / coverage.contacts.sum()
    names = [f"pass {n + 1}" for n in range(len(share))]
    line = ("contacts", *(f"{c} ({s:.0%})" for c, s in zip(coverage.contacts, share, strict=True)))
    about = "Contacts of a wheel with a cell at a row, by earlier passes over the place, which saw it from nearby."
    return TextTable("Rows by pass", ("wheels at rows", *names), (line,), about)


def headline(coverage: FeatureCoverage) -> str:
    """Return a sentence with the main numbers."""
    rates = ", ".join(
        f"{name} {number(rate)}" for name, rate in zip(FEATURE_SETS, coverage.whole.share, strict=True) if rate == rate
    )
    far = coverage.apart.length[HINDSIGHT]
    most = number(np.nanmax(far)) if np.isfinite(far).any() else "–"
    return f"valid by distance: {rates}; features differ from those in hindsight by up to {most} of their range"


def draw_rates(coverage: FeatureCoverage) -> Figure:
    """Draw valid rates by distance, of each drive, of all, and of the paper."""
    figure = Figure(figsize=(8.4, 4.4), dpi=130, layout="constrained")
    axes = plain(figure.subplots(), f"Valid features by distance, {coverage.whole.cells} cells")
    for i, drive in enumerate(coverage.drives if len(coverage.drives) > 1 else ()):
        axes.plot(PLACES, drive.share, color=SOFT, linewidth=0.8, label="" if i else "each drive")
    axes.plot(PLACES, coverage.whole.share, "o-", color=BLUE, label="all cells")
    axes.plot(PLACES, coverage.whole.in_reach, "o--", color=GREEN, label="cells within reach of the distance")
    axes.plot(PLACES, PAPER_RATES, "s:", color=ORANGE, label="paper")
    axes.set(ylim=(0, 1.05), ylabel="share of valid cells")
    axes.set_xticks(PLACES, TICKS)
    axes.legend(frameon=False, fontsize=8, loc="lower left")
    return figure


def draw_distances(coverage: FeatureCoverage) -> Figure:
    """Draw observation distances against the distance of each feature set."""
    figure = Figure(figsize=(8.4, 4.0), dpi=130, layout="constrained")
    axes = plain(figure.subplots(), "Distance from sensor to ground at the observation of valid features")
    low, middle, high = coverage.quartiles.T
    ahead = DISTANCES >= 0
    label = "of the set: vehicle ± 5 m"
    axes.bar(PLACES[1:][ahead], 2 * TOLERANCE, 0.8, DISTANCES[ahead] - TOLERANCE, color=GRID, label=label)
    axes.vlines(PLACES, low, high, color=BLUE, linewidth=5, alpha=0.5, label="quartiles")
    axes.plot(PLACES, middle, "o", color=BLUE, label="median")
    axes.set(ylabel="distance [m]", ylim=(0, None))
    axes.set_xticks(PLACES, TICKS)
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    return figure


def draw_differences(coverage: FeatureCoverage) -> Figure:
    """Draw l2 differences between sets as a matrix, and of each feature between neighbouring distances."""
    figure = Figure(figsize=(11.5, 4.8), dpi=130, layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
    length = coverage.apart.length
    image = left.imshow(length, cmap="viridis", vmin=0)
    for (row, column), value in np.ndenumerate(length):
        bright = np.isfinite(value) and value > 0.6 * np.nanmax(length)
        left.text(column, row, number(value), ha="center", va="center", fontsize=8, color=INK if bright else "white")
    left.set_xticks(PLACES, TICKS, rotation=45)
    left.set_yticks(PLACES, TICKS)
    left.set_title("Mean l2 difference relative to the features' range", loc="left", fontsize=10)
    figure.colorbar(image, ax=left, shrink=0.85)

    plain(right, "Differences of each feature between neighbouring distances")
    pairs = [f"{a} / {b}" for a, b in pairwise(FEATURE_SETS[1:])]
    for differences, colour, name, shift in (
        (coverage.apart, BLUE, "1 to 99 %", -0.13),
        (coverage.apart_of_total, PURPLE, "total", 0.13),
    ):
        for i, values in enumerate(differences.neighbours()):
            at = np.full(len(values), i + shift)
            right.plot(at, values, ".", color=colour, markersize=5, alpha=0.4, label="" if i else f"range {name}")
    right.axhline(PAPER_DIFFERENCE, color=ORANGE, linestyle=":", label="paper: 30 %")
    right.set_xticks(range(len(pairs)), pairs)
    right.set(xlabel="distances [m]", ylabel="mean absolute difference / range", ylim=(0, None))
    right.legend(frameon=False, fontsize=8)
    return figure


FIGURES: dict[str, tuple[str, Callable[[FeatureCoverage], Figure], str]] = {
    "rates": ("Valid rates", draw_rates, "Valid rates by distance; negative distances lie behind the vehicle."),
    "distances": (
        "Achieved observation distances",
        draw_distances,
        "Achieved observation distances; grey: distance of the vehicle from the cell.",
    ),
    "differences": (
        "Differences between sets",
        draw_differences,
        "Left: between all sets. Right: a dot per feature, between neighbouring distances.",
    ),
}
"""Title of the table above each figure, function that draws it, and caption."""


def coverage_sections(coverage: FeatureCoverage, figures: Collection[str] = tuple(FIGURES)) -> list[Section]:
    """Return all tables as sections of a page, with figures below them."""
    sections = []
    for table in tables(coverage):
        drawn = [(name, *FIGURES[name][1:]) for name in figures if FIGURES[name][0] == table.title]
        pictures = [picture(name, draw(coverage), caption) for name, draw, caption in drawn]
        sections.append(table_section(table, *pictures))
    return sections
