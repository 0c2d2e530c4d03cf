"""Coverage of a dataset's visual features as numbers and tables, by drive and in all."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from offpiste.core.conventions import DT, FEATURE_SETS
from offpiste.dataset import feature_coverage
from offpiste.dataset.feature_coverage import HINDSIGHT, PAPER_RATES
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dataset.wheel_passes import Passes, find_passes
from offpiste.mapping.terrain_map import wheel_positions
from offpiste.mapping.voxel_map import VoxelSettings
from offpiste.report.text_table import TextTable, number
from offpiste.rig.rig import Rig

STRIDE = 5
"""Rows between the places of the vehicle that decide what was within reach: 0.1 s."""


@dataclass(frozen=True)
class Rates:
    """Valid rates by feature set, of one drive or of all.

    Attributes:
        name: of the drive.
        cells: number of cells, each counted once per pass.
        share: valid share of all cells.
        of_hindsight: valid share of the cells that are valid in hindsight; 1 in hindsight, as in the paper's table.
        in_reach: valid share of the cells that the vehicle was at the set's distance from; NaN where unknown.
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
        whole: valid rates of all of them together.
        quartiles: quartiles of the distances at which features were observed [m].
        apart: differences between sets, relative to the features' ranges between the 1st and the 99th percentile.
        apart_of_total: the same relative to the total range of values, as the paper has it.
        unrelated: difference of unrelated cells, as in `apart.length`.
        contacts: contacts of wheels with cells, by how often the place was passed before; empty where unknown.
    """

    drives: tuple[Rates, ...]
    whole: Rates
    quartiles: Float[np.ndarray, "D 3"]
    apart: feature_coverage.Differences
    apart_of_total: feature_coverage.Differences
    unrelated: float
    contacts: Int[np.ndarray, " K"]


def measure_coverage(dataset: Dataset, *, seed: int = 0) -> FeatureCoverage | None:
    """Coverage of a dataset's features; None if no drive has features by distance.

    Args:
        seed: of the random pairs of unrelated cells.
    """
    result = [(drive, drive.rows.cells) for drive in dataset.drives if by_distance(drive.rows.cells)]
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


def by_distance(cells: Cells | None) -> bool:
    """Whether cells have visual features, with all feature sets."""
    return cells is not None and len(cells.valid) == len(FEATURE_SETS) and cells.features.shape[2] > 0


def passes_of(drive: StoredDrive, rig: Rig) -> Passes | None:
    """The passes that a drive's cells stand for, found again; None where they are not those of the usual map."""
    rows = drive.rows
    xy = path_of(drive)
    wheels = wheel_positions(xy, rows.state[:, 2].astype(np.float64), rig.wheel_positions())
    passes = find_passes(rows.time, xy, wheels, resolution=VoxelSettings().size)
    same = rows.cells is not None and np.array_equal(passes.index, rows.cells.index)
    return passes if same else None


def path_of(drive: StoredDrive) -> Float[np.ndarray, "N 2"]:
    """Places of the pose point in the world frame [m]; NaN where unknown."""
    return np.asarray(drive.rows.state[:, :2].astype(np.float64) + drive.rows.origin)


def seconds_of(drive: StoredDrive) -> float:
    """Length of a drive [s]."""
    return len(drive.rows.time) * DT


def _reached(drive: StoredDrive, passes: Passes | None) -> np.ndarray:
    if passes is None:
        assert drive.rows.cells is not None
        return np.zeros_like(drive.rows.cells.valid)
    time, xy = drive.rows.time[::STRIDE], path_of(drive)[::STRIDE]
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
    """All tables, in reading order."""
    counted = (_contacts(coverage),) if len(coverage.contacts) else ()
    return (_rate_table(coverage), _distances(coverage), _matrix(coverage), _neighbours(coverage), *counted)


def _rate_table(coverage: FeatureCoverage) -> TextTable:
    def line(name: str, rates: np.ndarray) -> tuple[str, ...]:
        return (name, *(number(rate) for rate in rates))

    def lines_of(rates: Rates) -> list[tuple[str, ...]]:
        name = f"{rates.name} ({rates.cells} cells)"
        return [
            line(name, rates.share),
            line("  of those valid in hindsight", rates.of_hindsight),
            line("  of those within reach", rates.in_reach),
        ]

    drives = coverage.drives if len(coverage.drives) > 1 else ()
    body = [line for rates in (*drives, coverage.whole) for line in lines_of(rates)]
    about = (
        "Share of cells under the wheels that have features, each counted once a pass. Within reach: only cells that "
        "the vehicle was at the set's distance from on that pass, ± 5 m; the start of a drive was never seen from 40 m."
    )
    names = ("valid rate by distance [m]", *FEATURE_SETS)
    return TextTable("Valid rates", names, (*body, line("paper", np.array(PAPER_RATES))), about)


def _distances(coverage: FeatureCoverage) -> TextTable:
    lines = [
        (name, *(number(value, 1) for value in column))
        for name, column in zip(("25 %", "median", "75 %"), coverage.quartiles.T, strict=True)
    ]
    about = (
        "From the sensor to the ground when the features were observed. The map keeps the closest observation, so what "
        "lies behind the vehicle was seen just before it was driven over, unless a camera looks back."
    )
    names = ("observation distance [m]", *FEATURE_SETS)
    return TextTable("Achieved observation distances", names, tuple(lines), about)


def _matrix(coverage: FeatureCoverage) -> TextTable:
    length = coverage.apart.length
    lines = [(name, *(number(v) for v in row)) for name, row in zip(FEATURE_SETS, length, strict=True)]
    about = (
        "Mean l2 norm of the difference of the same cells' features between two sets, where both are valid, divided by "
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
        "Mean absolute difference of each feature between distances next to each other, divided by that feature's own "
        "range. The paper finds 0.3 of the total range of values."
    )
    return TextTable("Differences of single features", ("difference / range", *pairs), tuple(lines), about)


def _contacts(coverage: FeatureCoverage) -> TextTable:
    share = coverage.contacts / coverage.contacts.sum()
    names = [f"pass {n + 1}" for n in range(len(share))]
    line = ("contacts", *(f"{c} ({s:.0%})" for c, s in zip(coverage.contacts, share, strict=True)))
    about = "A wheel on a cell at a row, by how often that place was passed before: later passes have seen it nearby."
    return TextTable("Rows by pass", ("wheels at rows", *names), (line,), about)


def headline(coverage: FeatureCoverage) -> str:
    """Sentence with the main numbers."""
    rates = ", ".join(
        f"{name} {number(rate)}" for name, rate in zip(FEATURE_SETS, coverage.whole.share, strict=True) if rate == rate
    )
    far = coverage.apart.length[HINDSIGHT]
    most = number(np.nanmax(far)) if np.isfinite(far).any() else "–"
    return f"valid by distance: {rates}; features differ from hindsight's by up to {most} of their range"
