"""Statistics of errors with intervals bootstrapped over drives, blocks within them, and seeds.

Windows overlap, blocks of a drive share its ground, and all windows share the runs that predict them, so that they are
not independent. Each resample draws drives, then blocks within each drawn drive, then seeds, all with replacement. If
drives do not differ this is conservative: two stages count the spread between blocks twice (Davison and Hinkley,
Bootstrap Methods and their Application, 1997, section 3.8).

Drives are the independent units; for a single drive, its blocks. Fewer than `MIN_UNITS` units give no interval.
Intervals are percentiles of resampled statistics, so that the interval of a distance has no negative bound.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import msgspec
import numpy as np
from jaxtyping import Float, Int
from scipy.special import ndtr, stdtrit

from offpiste.core.conventions import DT
from offpiste.report.text_table import interval

BLOCK_SECONDS = 10.0
"""Default length of a block, twice a horizon, so that windows of every other block share no row [s]."""

RESAMPLES = 2000
MIN_UNITS = 5
"""Smallest number of independent units for an interval."""

NO_INTERVAL = (np.nan, np.nan)


class Levels(msgspec.Struct, frozen=True):
    """Numbers of drives (worlds or recordings), blocks in all of them, and seeds behind an interval."""

    drives: int
    blocks: int
    seeds: int = 1

    @property
    def units(self) -> int:
        """Number of independent units: drives, or blocks of a single drive."""
        return self.drives if self.drives > 1 else self.blocks

    def text(self) -> str:
        """Return text such as "10 drives, 90 blocks, 3 seeds" or "40 blocks of one drive, 3 seeds"."""
        seeds = _count(self.seeds, "seed")
        if self.drives == 1:
            return f"{_count(self.blocks, 'block')} of one drive, {seeds}"
        return f"{_count(self.drives, 'drive')}, {_count(self.blocks, 'block')}, {seeds}"

    @property
    def caveat(self) -> str:
        """Reason for a missing interval, or limitation of an interval; "" if there is neither."""
        if self.units < MIN_UNITS:
            unit = "drive" if self.drives > 1 else "block"
            found = _count(self.units, unit) + " of one drive" * (self.drives == 1)
            return f"–: no interval, since there are only {found} and {MIN_UNITS} {unit}s are needed."
        return "Intervals are over blocks of one drive and say nothing about other drives." if self.drives == 1 else ""


def _count(number: int, name: str) -> str:
    return f"{number} {name}{'s' * (number != 1)}"


class Statistics(msgspec.Struct, frozen=True):
    """Statistics of an error over windows; `ci95` is of the mean. Infinite if predictions failed."""

    mean: float
    median: float
    q1: float
    q3: float
    p90: float
    ci95: tuple[float, float]


class PairedDifference(msgspec.Struct, frozen=True):
    """Mean of a difference or ratio over the same windows, and its 95 % interval."""

    mean: float
    ci95: tuple[float, float]


def percent(difference: PairedDifference, digits: int = 1) -> str:
    """Format a relative difference and its interval in percent; a dash if it is not finite."""
    if not np.isfinite(difference.mean):
        return "–"
    low, high = (100 * bound for bound in difference.ci95)
    return f"{100 * difference.mean:+.{digits}f} % {interval((low, high), digits)}"


@dataclass(frozen=True)
class Resampling:
    """Resamples of drives, blocks and seeds, the same for all statistics on the same windows.

    Attributes:
        block: index of each window's block, 0 ... G - 1.
        draws: number of times each block was drawn in each resample.
        drives: number of drives.
        seed: of the draws of seeds.
    """

    block: Int[np.ndarray, " n"]
    draws: Int[np.ndarray, "R G"]
    drives: int
    seed: int

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(self.draws.shape[1])

    def levels(self, seeds: int = 1) -> Levels:
        """Return the numbers of drives, blocks and seeds."""
        return Levels(self.drives, self.blocks, seeds)

    def seed_draws(self, seeds: int) -> Int[np.ndarray, "R S"]:
        """Return the number of times each run is drawn, the same for all models, so that they are paired by seed.

        One run less than available is drawn, which makes the variance of the mean unbiased (McCarthy and Snowden, The
        Bootstrap and Finite Population Sampling, 1985).
        """
        rng = np.random.default_rng((self.seed, seeds))
        return rng.multinomial(max(seeds - 1, 1), np.full(seeds, 1 / seeds), size=len(self.draws))

    def means(self, values: Float[np.ndarray, "*S n"]) -> Float[np.ndarray, " R"]:
        """Return the mean over windows and seeds of each resample."""
        runs = values.reshape(-1, values.shape[-1])
        sums = np.stack([np.bincount(self.block, weights=run, minlength=self.blocks) for run in runs])
        counts = np.bincount(self.block, minlength=self.blocks)
        seeds = self.seed_draws(len(runs))
        of_seeds = (self.draws @ sums.T) / (self.draws @ counts)[:, None]
        return np.asarray((of_seeds * seeds).sum(axis=1) / seeds.sum(axis=1))

    def interval(self, means: Float[np.ndarray, " R"]) -> tuple[float, float]:
        """Return the 95 % interval of resampled means; NaN with fewer than `MIN_UNITS` units.

        Plain percentiles are too narrow by sqrt((N-1)/N) and assume a normal distribution; they are expanded to match
        Student's (Hesterberg, The American Statistician 69, 2015, "expanded percentile interval").
        """
        units = self.levels().units
        if units < MIN_UNITS or not np.isfinite(means).all():
            return NO_INTERVAL
        tail = ndtr(-np.sqrt(units / (units - 1)) * stdtrit(units - 1, 0.975))
        low, high = np.quantile(means, [tail, 1 - tail])
        return (float(low), float(high))


def blocks(
    drive: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], *, seconds: float = BLOCK_SECONDS
) -> Int[np.ndarray, " n"]:
    """Return the index of each window's block: consecutive windows of one drive that start within `seconds`.

    The last block of a drive includes the remaining windows if they start within half a block.

    Args:
        drive, row: of each window, in ascending order.
    """
    length = round(seconds / DT)
    number = np.zeros(len(row), dtype=np.int64)
    following = 0
    for name in np.unique(drive):
        mine = np.flatnonzero(drive == name)
        rows = row[mine]
        first = 0
        while first < len(rows):
            end = int(np.searchsorted(rows, rows[first] + length))
            if end < len(rows) and rows[-1] - rows[end] < length / 2 and rows[end] - rows[end - 1] < length:
                end = len(rows)
            number[mine[first:end]] = following
            following, first = following + 1, end
    return number


def resampling(
    drive: Int[np.ndarray, " n"], block: Int[np.ndarray, " n"], seed: int, *, resamples: int = RESAMPLES
) -> Resampling:
    """Resample drives, and blocks within each drawn drive, with replacement.

    Args:
        drive: drive of each window, or another independent unit.
        block: index of each window's block, 0 ... G - 1; no block lies in two drives.
    """
    rng, total = np.random.default_rng(seed), int(block.max()) + 1
    names, inside = np.unique(drive, return_inverse=True)
    if len(names) == 1:
        drawn = np.ones((resamples, 1), np.int64)
    else:
        drawn = rng.multinomial(len(names), np.full(len(names), 1 / len(names)), size=resamples)
    draws = np.zeros((resamples, total), np.int64)
    for number in range(len(names)):
        mine = np.unique(block[inside == number])
        draws[:, mine] = rng.multinomial(drawn[:, number] * len(mine), np.full(len(mine), 1 / len(mine)))
    return Resampling(block, draws, len(names), seed)


@runtime_checkable
class Located(Protocol):
    """Windows, by index of the drive and row of the start."""

    @property
    def drive(self) -> Int[np.ndarray, " n"]: ...  # noqa: D102
    @property
    def row(self) -> Int[np.ndarray, " n"]: ...  # noqa: D102


@dataclass(frozen=True)
class Sampling:
    """Seed of the resamples and length of a block [s]."""

    seed: int = 0
    block_seconds: float = BLOCK_SECONDS

    def on(self, windows: Located) -> Resampling:
        """Return resamples of windows in any order; the same windows always get the same resamples."""
        order = np.lexsort((windows.row, windows.drive))
        block = np.empty(len(order), np.int64)
        block[order] = blocks(windows.drive[order], windows.row[order], seconds=self.block_seconds)
        return resampling(windows.drive, block, self.seed)


def summary(values: Float[np.ndarray, "*S n"], drawn: Resampling) -> Statistics:
    """Compute statistics of an error over windows; quantiles are of each window's mean over the seeds."""
    over_seeds = values.reshape(-1, values.shape[-1]).mean(axis=0)
    q1, median, q3, p90 = _quantiles(over_seeds, (0.25, 0.5, 0.75, 0.9))
    failed = not np.isfinite(values).all()
    ci95 = NO_INTERVAL if failed else drawn.interval(drawn.means(values))
    return Statistics(float(values.mean()), median, q1, q3, p90, ci95)


def paired(values: Float[np.ndarray, "*S n"], other: Float[np.ndarray, "*Q n"], drawn: Resampling) -> PairedDifference:
    """Compute the mean of `values - other` on the same windows; negative if `values` are smaller."""
    if not (np.isfinite(values).all() and np.isfinite(other).all()):
        return PairedDifference(float(values.mean()) - float(other.mean()), NO_INTERVAL)
    difference = drawn.means(values) - drawn.means(other)
    return PairedDifference(float(values.mean() - other.mean()), drawn.interval(difference))


def relative(
    values: Float[np.ndarray, "*S n"], other: Float[np.ndarray, "*Q n"], drawn: Resampling
) -> PairedDifference:
    """Compute `mean(values) / mean(other) - 1` on the same windows: -0.3 if the errors are 30 % smaller."""
    if not (np.isfinite(values).all() and np.isfinite(other).all() and other.mean() > 0):
        return PairedDifference(np.nan, NO_INTERVAL)
    ratios = drawn.means(values) / np.maximum(drawn.means(other), 1e-300) - 1
    return PairedDifference(float(values.mean() / other.mean() - 1), drawn.interval(ratios))


def _quantiles(values: Float[np.ndarray, " n"], at: tuple[float, ...]) -> list[float]:
    """Return quantiles, linear between values; infinite if an infinite value contributes."""
    huge = 1e300
    result = np.quantile(np.minimum(values, huge), at)
    # Any noticeable share of 1e300 is far above any error in metres.
    return [float(value) if value < 1e200 else np.inf for value in result]
