"""Statistics of errors, with intervals bootstrapped over blocks, since overlapping windows are not independent."""

from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from offpiste.conventions import DT
from offpiste.evaluation.errors import Errors
from offpiste.evaluation.evaluated_windows import EvaluatedWindows

BLOCK_SECONDS = 10.0
"""Default length of a block: twice a horizon, so that windows of one block and of the next but one share no row."""

RESAMPLES = 2000
MIN_BLOCKS = 3
"""With fewer blocks there is no interval: [nan, nan]."""


class Statistics(msgspec.Struct, frozen=True):
    """Statistics of one error over windows; `ci95` is of the mean. Infinite where failed predictions make it so."""

    mean: float
    median: float
    q1: float
    q3: float
    p90: float
    ci95: tuple[float, float]


class PairedDifference(msgspec.Struct, frozen=True):
    """Mean of a difference (or of a ratio) over the same windows, and its 95 % interval."""

    mean: float
    ci95: tuple[float, float]


@dataclass(frozen=True)
class Resampling:
    """Blocks drawn with replacement, once for all statistics on the same windows.

    Attributes:
        block: number of each window's block, 0 ... G - 1.
        draws: how often each block was drawn in each resample.
    """

    block: Int[np.ndarray, " n"]
    draws: Int[np.ndarray, "R G"]

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(self.draws.shape[1])

    def means(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " R"]:
        """Mean over the windows of each resample."""
        sums = np.bincount(self.block, weights=values, minlength=self.blocks)
        counts = np.bincount(self.block, minlength=self.blocks)
        return np.asarray((self.draws @ sums) / (self.draws @ counts))

    def interval(self, means: Float[np.ndarray, " R"]) -> tuple[float, float]:
        """The middle 95 % of resampled means, a little more where blocks are few.

        Plain percentiles are too narrow by sqrt((G-1)/G) and take the normal distribution for Student's; the
        percentiles are moved out to make up for it (Hesterberg, The American Statistician 69, 2015, "expanded
        percentile interval").
        """
        if self.blocks < MIN_BLOCKS or not np.isfinite(means).all():
            return (np.nan, np.nan)
        reach = np.sqrt(self.blocks / (self.blocks - 1)) * stats.t.ppf(0.975, self.blocks - 1)
        tail = stats.norm.cdf(-reach)
        low, high = np.quantile(means, [tail, 1 - tail])
        return (float(low), float(high))


def blocks(
    drive: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], *, seconds: float = BLOCK_SECONDS
) -> Int[np.ndarray, " n"]:
    """Number of each window's block: consecutive windows of one drive that start within `seconds`.

    A drive's last block takes in the windows that are left over, if they start within half a block.

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


def resampling(block: Int[np.ndarray, " n"], rng: np.random.Generator, *, resamples: int = RESAMPLES) -> Resampling:
    """Draw as many blocks as there are, with replacement, many times."""
    total = int(block.max()) + 1
    return Resampling(block, rng.multinomial(total, np.full(total, 1 / total), size=resamples))


@dataclass(frozen=True)
class Sampling:
    """Settings of the intervals: blocks of `block_seconds`, drawn from a seeded generator."""

    seed: int = 0
    block_seconds: float = BLOCK_SECONDS

    def on(self, windows: Errors | EvaluatedWindows) -> Resampling:
        """Blocks of these windows. The same windows always get the same draws."""
        block = blocks(windows.drive, windows.row, seconds=self.block_seconds)
        return resampling(block, np.random.default_rng(self.seed))


def summary(values: Float[np.ndarray, " n"], drawn: Resampling) -> Statistics:
    """Statistics of one error over windows."""
    q1, median, q3, p90 = _quantiles(values, (0.25, 0.5, 0.75, 0.9))
    failed = not np.isfinite(values).all()
    interval = (np.nan, np.nan) if failed else drawn.interval(drawn.means(values))
    return Statistics(float(values.mean()), median, q1, q3, p90, interval)


def paired(values: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"], drawn: Resampling) -> PairedDifference:
    """Mean of `values - other` on the same windows: negative where `values` are the smaller errors."""
    if not (np.isfinite(values).all() and np.isfinite(other).all()):
        return PairedDifference(float(values.mean()) - float(other.mean()), (np.nan, np.nan))
    difference = values - other
    return PairedDifference(float(difference.mean()), drawn.interval(drawn.means(difference)))


def relative(values: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"], drawn: Resampling) -> PairedDifference:
    """`mean(values) / mean(other) - 1` on the same windows: -0.3 where the errors are 30 % smaller."""
    if not (np.isfinite(values).all() and np.isfinite(other).all() and other.mean() > 0):
        return PairedDifference(np.nan, (np.nan, np.nan))
    ratios = drawn.means(values) / np.maximum(drawn.means(other), 1e-300) - 1
    return PairedDifference(float(values.mean() / other.mean() - 1), drawn.interval(ratios))


def _quantiles(values: Float[np.ndarray, " n"], at: tuple[float, ...]) -> list[float]:
    """Quantiles, linear between values; infinite as soon as an infinite value has a part in them."""
    huge = 1e300
    result = np.quantile(np.minimum(values, huge), at)
    # Any share of 1e300 worth naming is far above any error in metres.
    return [float(value) if value < 1e200 else np.inf for value in result]
