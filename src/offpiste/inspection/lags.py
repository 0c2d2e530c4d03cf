"""How well one signal explains another at each lag."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True)
class LagFit:
    """Least squares `target = base + gain * source(t - lag)` for each lag.

    Attributes:
        lags: tried lags [s]; positive: the target follows the source.
        r: partial correlation at each lag, with the sign of the gain.
        gain: at each lag.
        count: rows that were used.
    """

    lags: Float[np.ndarray, " L"]
    r: Float[np.ndarray, " L"]
    gain: Float[np.ndarray, " L"]
    count: int

    def best(self, low: float = -np.inf, high: float = np.inf, *, sign: int = 0) -> int:
        """Index of the lag within [low, high] that explains most, with a gain of this sign if one is asked for."""
        score = np.abs(self.r) if sign == 0 else sign * self.r
        score = np.where((self.lags >= low - 1e-9) & (self.lags <= high + 1e-9), score, -np.inf)
        return int(score.argmax())


def fit_lags(
    target: Float[np.ndarray, " n"],
    base: Float[np.ndarray, "n b"],
    lagged: Float[np.ndarray, "L n"],
    lags: Float[np.ndarray, " L"],
    rows: Bool[np.ndarray, " n"],
) -> LagFit | None:
    """Fit `target` by `base` and one row of `lagged` at a time (partial regression, Frisch and Waugh 1933).

    Args:
        lagged: the source at `t - lag`, one row a lag; NaN where unknown.
        rows: which to use; those with a NaN anywhere are left out as well, so that all lags see the same rows.

    Returns:
        None where too few rows remain or nothing varies.
    """
    use = rows & np.isfinite(target) & np.isfinite(base).all(axis=1) & np.isfinite(lagged).all(axis=0)
    if use.sum() < 40:
        return None
    x, y = lagged[:, use], target[use]
    span, _ = np.linalg.qr(base[use])
    y = y - span @ (span.T @ y)
    x = x - (x @ span) @ span.T
    power, spread = np.einsum("Ln,Ln->L", x, x), float(y @ y)
    if spread <= 1e-12 or not (power > 1e-12).all():
        return None
    product = x @ y
    return LagFit(lags, product / np.sqrt(power * spread), product / power, int(use.sum()))
