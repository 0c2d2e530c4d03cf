"""How well a control explains the motion at each lag, and the delay that follows from it.

A vehicle follows its controls: motion up to 0.4 s after steering is a response, motion before it is a wrong stamp.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.inspection.findings import Finding, number
from offpiste.logs.channel import Channel
from offpiste.rig.rig import Rig

LAGS: Final = np.arange(-1.5, 1.51, 0.05)
"""Lags of the motion behind a control that are tried [s]."""
_CLEARER = 0.03
"""A lag outside of the vehicle's own must explain this much more of the variance than the best one inside."""


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
        """Index of the lag within [low, high] that explains most, with a gain of this sign if it is not 0."""
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


def lagged(channel: Channel, time: Float[np.ndarray, " n"], rig: Rig) -> Float[np.ndarray, "L n"]:
    """A control at `time - lag` for each of `LAGS`, as the rig interpolates it; NaN in gaps."""
    return np.stack([sampled(channel, time - lag, rig) for lag in LAGS])


def sampled(channel: Channel, at: Float[np.ndarray, " n"], rig: Rig) -> Float[np.ndarray, " n"]:
    """A control at some times, as the rig interpolates it; NaN in gaps."""
    hold = rig.channels[channel.name].interpolation == "hold"
    read = channel.hold if hold else channel.linear
    return read(at, max_gap=max(rig.clock.max_gap, 1.0))[:, 0]


def check_delay(
    name: str, fit: LagFit, own: tuple[float, float], rig: Rig, *, clear: float, sign: int = 0
) -> list[Finding]:
    """A finding if the motion comes earlier or later than the vehicle's own response.

    Args:
        own: delays of the motion that are the vehicle's own [s].
        clear: correlation above which a delay is clear.
        sign: of the right effect; 0: either.
    """
    best, inside = fit.best(sign=sign), fit.best(*own, sign=sign)
    lag = float(fit.lags[best])
    gained = fit.r[best] ** 2 - max(fit.r[inside] * (sign or np.sign(fit.r[best])), 0.0) ** 2
    # A best lag at the end of those tried is no maximum: slow signals fit anywhere.
    weak = abs(fit.r[best]) < clear
    if weak or own[0] <= lag <= own[1] or gained < _CLEARER or best in (0, len(fit.lags) - 1):
        return []
    evidence = (
        f"the motion is {abs(lag):.2f} s {'before' if lag < 0 else 'after'} it: R2 {fit.r[best] ** 2:.2f} there and "
    )
    evidence += f"{fit.r[inside] ** 2:.2f} at {fit.lags[inside]:.2f} s"
    what = "is stamped after the motion that it causes" if lag < 0 else "comes long before the motion"
    remedy = f"channels.{name}.delay = {number(rig.channels[name].delay - lag)}"
    if lag < 0:
        remedy += "; if it is called a command, it is a copy of a measurement"
    return [Finding("warning" if lag < 0 or lag > 1 else "note", name, what, evidence, remedy, gained)]
