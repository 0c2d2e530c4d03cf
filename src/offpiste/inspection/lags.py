"""Lagged regression of the motion on a signal: gain, sign and delay, with their uncertainties.

A vehicle follows its controls: motion up to half a second after steering is a response, motion before it indicates a
wrong stamp. Uncertainties are from a jackknife over blocks, since neighbouring samples are not independent.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.conventions import SIGMA_PER_MEDIAN
from offpiste.logs.channel import Channel
from offpiste.rig.rig import Rig

LAGS: Final = np.arange(-1.5, 1.51, 0.05)
"""Candidate lags of the motion behind a control [s]."""
_BLOCK: Final = 100
"""Number of rows of a block: 5 s."""
SURE: Final = 3.0
"""Significance threshold in standard deviations."""
_OUTLIER: Final = 4.0
"""Ratio of residual to scale above which a row is down-weighted."""


@dataclass(frozen=True)
class LagFit:
    """Least-squares fit `target = base + gain * source(t - lag)` for each lag.

    Attributes:
        lags: candidate lags [s]; positive: the target follows the source.
        r: partial correlation at each lag, with the sign of the gain.
        gain: at each lag.
        count: number of rows used.
        left_out: `r` with one block of rows left out at a time.
        gain_left_out: `gain` likewise.
    """

    lags: Float[np.ndarray, " L"]
    r: Float[np.ndarray, " L"]
    gain: Float[np.ndarray, " L"]
    count: int
    left_out: Float[np.ndarray, "B L"]
    gain_left_out: Float[np.ndarray, "B L"]

    def best(self, low: float = -np.inf, high: float = np.inf, *, sign: int = 0) -> int:
        """Return the index of the best lag within [low, high], with a gain of this sign if it is not 0."""
        score = np.abs(self.r) if sign == 0 else sign * self.r
        score = np.where((self.lags >= low - 1e-9) & (self.lags <= high + 1e-9), score, -np.inf)
        return int(score.argmax())

    @property
    def strength(self) -> float:
        """Return the largest absolute correlation over all lags."""
        return float(np.abs(self.r).max())

    def delay(self, index: int) -> tuple[float, float]:
        """Return the interpolated lag of the peak near an index, and its standard deviation [s]."""
        sign = np.sign(self.r[index])
        lag = _peak(self.lags, sign * self.r, index)
        near = slice(max(index - 6, 0), index + 7)
        tops = [_peak(self.lags, sign * row, int((sign * row)[near].argmax()) + near.start) for row in self.left_out]
        return lag, jackknife(np.array(tops))

    def r_sigma(self, index: int) -> float:
        """Return the standard deviation of the correlation at an index."""
        return jackknife(self.left_out[:, index])

    def gained(self, index: int, other: int) -> tuple[float, float]:
        """Return the gain in explained variance over another lag, for equal signs, and its standard deviation."""
        sign = np.sign(self.r[index])

        def more(r: np.ndarray) -> np.ndarray:
            return np.asarray(r[..., index] ** 2 - np.maximum(sign * r[..., other], 0.0) ** 2)

        return float(more(self.r)), jackknife(more(self.left_out))

    def gain_sigma(self, index: int) -> float:
        """Return the standard deviation of the gain at an index."""
        return jackknife(self.gain_left_out[:, index])


def jackknife(left_out: Float[np.ndarray, " B"]) -> float:
    """Return the jackknife standard deviation of leave-one-block-out estimates (Quenouille 1956); inf for one block."""
    count = len(left_out)
    return float(np.sqrt((count - 1) * np.var(left_out))) if count > 1 else np.inf


def fit_lags(
    target: Float[np.ndarray, " n"],
    base: Float[np.ndarray, "n b"],
    lagged: Float[np.ndarray, "L n"],
    lags: Float[np.ndarray, " L"],
    rows: Bool[np.ndarray, " n"],
) -> LagFit | None:
    """Fit `target` by `base` and one row of `lagged` at a time (partial regression, Frisch and Waugh 1933).

    Args:
        lagged: the source at `t - lag`, one row per lag; NaN if unknown.
        rows: rows to use; rows with any NaN are dropped, so that all lags use the same rows.

    Returns:
        None with too few rows or constant signals.
    """
    use = rows & np.isfinite(target) & np.isfinite(base).all(axis=1) & np.isfinite(lagged).all(axis=0)
    if use.sum() < 40:
        return None
    y, known, columns = target[use], base[use], np.flatnonzero(use)
    starts = np.flatnonzero(np.diff(columns // _BLOCK, prepend=-1))
    weight = np.ones(len(y))
    # Robust to glitches: rows with large residuals are down-weighted in two steps.
    for last in (False, False, True):
        sums = _Sums.of(known, lagged, y, weight, columns, starts)
        r, gain, varies = sums.whole().solve()
        if not varies:
            return None
        if last:
            break
        residual = _residual(known, lagged[np.abs(r).argmax()][use], y, weight)
        scale = max(SIGMA_PER_MEDIAN * float(np.median(np.abs(residual))), 1e-12)
        weight = np.minimum(1.0, _OUTLIER * scale / np.maximum(np.abs(residual), 1e-12)) ** 2
    left_out, gain_left_out, varies = sums.without_each().solve()
    varies &= len(starts) > 1
    return LagFit(lags, r, gain, int(use.sum()), left_out[varies], gain_left_out[varies])


@dataclass(frozen=True)
class _Sums:
    """Sums of products per block or in total: base with itself and the target, each lag with both."""

    base: Float[np.ndarray, "*B b b"]
    target: Float[np.ndarray, "*B b"]
    power: Float[np.ndarray, "*B"]
    crossed: Float[np.ndarray, "*B L b"]
    product: Float[np.ndarray, "*B L"]
    spread: Float[np.ndarray, "*B L"]

    @classmethod
    def of(
        cls,
        base: Float[np.ndarray, "n b"],
        lagged: Float[np.ndarray, "L N"],
        y: Float[np.ndarray, " n"],
        weight: Float[np.ndarray, " n"],
        columns: Int[np.ndarray, " n"],
        starts: Int[np.ndarray, " B"],
    ) -> "_Sums":
        """Return the sums per block; `columns` selects columns of `lagged`, `starts` are the blocks' first rows."""
        sums = []
        # Block by block, to limit memory on long logs.
        for block in (slice(*ends) for ends in pairwise((*starts, len(y)))):
            part, weighed = lagged[:, columns[block]], base[block] * weight[block, None]
            target = weight[block] * y[block]
            power = np.asarray(target @ y[block])
            of_lags = part @ weighed, part @ target, part**2 @ weight[block]
            sums.append((weighed.T @ base[block], weighed.T @ y[block], power, *of_lags))
        return cls(*(np.stack(each) for each in zip(*sums, strict=True)))

    def whole(self) -> "_Sums":
        """Return the sums over all blocks."""
        return _Sums(*(np.asarray(part.sum(axis=0)) for part in vars(self).values()))

    def without_each(self) -> "_Sums":
        """Return leave-one-out sums: for each block, the sum of all others."""
        return _Sums(*map(_without_each, vars(self).values()))

    def solve(self) -> tuple[Float[np.ndarray, "*B L"], Float[np.ndarray, "*B L"], Bool[np.ndarray, "*B"]]:
        """Return partial correlation and gain at each lag, and a mask of solvable cases; other values are undefined."""
        inverse = np.linalg.pinv(self.base)
        projected = self.crossed @ inverse
        product = self.product - np.einsum("...Lb,...b->...L", projected, self.target)
        spread = self.spread - np.einsum("...Lb,...Lb->...L", projected, self.crossed)
        power = self.power - np.einsum("...b,...bc,...c->...", self.target, inverse, self.target)
        varies = np.asarray((power > 1e-12) & (spread > 1e-12).all(axis=-1))
        with np.errstate(invalid="ignore", divide="ignore"):
            return product / np.sqrt(spread * power[..., None]), product / spread, varies


def _without_each(part: Float[np.ndarray, "B ..."]) -> Float[np.ndarray, "B ..."]:
    """Return leave-one-out sums; subtraction from the total would leave rounding errors in place of zeros."""
    none = np.zeros_like(part[:1])
    before = np.concatenate((none, part[:-1].cumsum(axis=0)))
    return before + np.concatenate((part[:0:-1].cumsum(axis=0)[::-1], none))


def _residual(base: np.ndarray, x: np.ndarray, y: np.ndarray, weight: np.ndarray) -> Float[np.ndarray, " n"]:
    columns = np.column_stack((base, x))
    root = np.sqrt(weight)
    solution = np.linalg.lstsq(columns * root[:, None], y * root, rcond=None)[0]
    return np.asarray(y - columns @ solution)


def _peak(lags: Float[np.ndarray, " L"], score: Float[np.ndarray, " L"], index: int) -> float:
    """Return the lag of a maximum, refined by a parabola through its neighbours."""
    if not 0 < index < len(lags) - 1:
        return float(lags[index])
    before, at, after = score[index - 1 : index + 2]
    bend = before - 2 * at + after
    shift = 0.5 * (before - after) / bend if bend < -1e-12 else 0.0
    return float(lags[index] + np.clip(shift, -0.5, 0.5) * (lags[1] - lags[0]))


def lagged(channel: Channel, time: Float[np.ndarray, " n"], rig: Rig) -> Float[np.ndarray, "L n"]:
    """Return a control at `time - lag` for each of `LAGS`, interpolated as in the rig; NaN in gaps."""
    return np.stack([sampled(channel, time - lag, rig) for lag in LAGS])


def sampled(channel: Channel, at: Float[np.ndarray, " n"], rig: Rig) -> Float[np.ndarray, " n"]:
    """Return a control at some times, interpolated as in the rig; NaN in gaps."""
    read = channel.hold if rig.channels[channel.name].holds else channel.linear
    return read(at, max_gap=max(rig.clock.max_gap, 1.0))[:, 0]
