"""Fits of the steering response: sign, delay and scale.

The **steady** fit explains the yaw rate by speed times steering; the **dynamic** fit explains the yaw rate a moment
later by the current yaw rate and the steering in between. A drifting vehicle countersteers: the steady relation then
vanishes or changes its sign, but steering to the left still increases the yaw rate.

Understeer grows with speed: yaw rate = speed * steering / (wheelbase (1 + K speed^2)). The **extrapolated** fit
estimates it, so that only the geometry remains at zero speed.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtr, stdtrit

from offpiste.inspection.driven_path import STEP, TURNING, DrivenPath
from offpiste.inspection.held import while_held
from offpiste.inspection.lags import LAGS, SURE, LagFit, fit_lags, lagged
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.rig.rig import Rig

_AHEAD: Final = 0.2
"""Time from the regressors to the yaw rate in the dynamic fit [s]."""
_STEADY_EFFECT: Final = 0.5
DYNAMIC_EFFECT: Final = 0.3
"""Minimum correlations that indicate an effect."""
_NO_DRIFT: Final = 0.95
"""Minimum correlation of the steady fit of a vehicle that does not drift."""
_SMOOTHINGS: Final = (2, 4, 6)
"""Candidate averaging lengths of the steering, in lags; actuators follow fast steering only partly."""
_GRIPPING: Final = 3.0
"""Maximum lateral acceleration with little tyre slip [m/s^2]."""
_ROUNDS: Final = 5
"""Number of iterations for the steering scale and the rows with little slip."""


@dataclass(frozen=True)
class SteeringFit:
    """Steady and dynamic fits of a steering channel, and three more fits for its scale.

    Attributes:
        steady, dynamic: fits to all moving rows.
        settled: steady fit with the averaging time of the steering that explains most variance.
        gripping: the same for rows in which speed and steering imply a small lateral acceleration; equal to `settled`
            if these rows are too few.
        extrapolated: fit of speed times steering to the yaw rate with understeer, in units of the channel times m, so
            that its inverse is the curvature per unit at zero speed; None if unknown.
        centre, centre_sigma: steering for driving straight in the `gripping` rows, in the channel's unit (for angles,
            the tangent), and its standard deviation; 0 and infinity if the rows are too few.
    """

    steady: LagFit
    dynamic: LagFit
    settled: LagFit
    gripping: LagFit
    extrapolated: LagFit | None
    centre: float
    centre_sigma: float

    @property
    def has_effect(self) -> bool:
        """Return whether the steering turns the vehicle, in either direction."""
        return self.steady.strength >= _STEADY_EFFECT or self.dynamic.strength >= DYNAMIC_EFFECT

    @property
    def sign(self) -> int:
        """Sign of the effect, 0 if unclear; if the fits differ, as in a drift, the dynamic fit decides."""
        steady, dynamic = (_sure_sign(fit) for fit in (self.steady, self.dynamic))
        if steady == dynamic or not dynamic or (steady and self.steady.strength > _NO_DRIFT):
            return steady
        return dynamic if self.dynamic.strength >= DYNAMIC_EFFECT else 0


def _sure_sign(fit: LagFit) -> int:
    best, blocks = fit.best(), len(fit.left_out)
    # With few blocks, use Student's t at the significance of `SURE` in a normal distribution.
    sure = stdtrit(blocks - 1, ndtr(SURE)) if blocks > 1 else np.inf
    return int(np.sign(fit.r[best])) if abs(fit.r[best]) > sure * fit.r_sigma(best) else 0


def steering_fit(channel: Channel, path: DrivenPath, rig: Rig, *, measured: bool) -> SteeringFit | None:
    """Fit the yaw rate to forward speed times steering (the tangent for an angle) with a free centre.

    Args:
        measured: whether the rig's geometry defines the rows with little slip; otherwise the fitted scale does.

    Returns:
        Gains in 1/m per unit of the channel; None if the motion is insufficient.
    """
    angle = lagged(channel, path.time, rig)
    wheel = np.tan(np.clip(angle, -1.4, 1.4)) if channel.name == "steer_angle" else angle
    turning = path.forward * wheel
    moving = moving_rows(path)
    steady = fit_lags(path.yaw_rate, path.forward[:, None], turning, LAGS, moving)
    later = round(_AHEAD / STEP)
    then = _shifted(path.forward, later)
    base = np.stack((path.yaw_rate, then), axis=1)
    dynamic = fit_lags(_shifted(path.yaw_rate, later), base, _shifted(turning, later), LAGS, moving)
    if steady is None or dynamic is None:
        return None
    per_unit = curvature_per_unit(channel.name, rig) if measured else None
    return SteeringFit(steady, dynamic, *_scale_fits(wheel, steady, path, per_unit))


def _scale_fits(
    wheel: Float[np.ndarray, "L n"], steady: LagFit, path: DrivenPath, per_unit: float | None
) -> tuple[LagFit, LagFit, LagFit | None, float, float]:
    """Return the fits `settled`, `gripping` and `extrapolated`, and the centre with its standard deviation.

    Args:
        wheel: steering at each of `LAGS`.
        per_unit: curvature at a steering of 1 [1/m], or None.
    """
    moving = moving_rows(path)
    settled, averaged = steady, path.forward * wheel[steady.best()]
    for count in _SMOOTHINGS:
        smooth = path.forward * _averaged(wheel[::2], count)
        fit = fit_lags(path.yaw_rate, path.forward[:, None], smooth, _averaged(LAGS[::2], count), moving)
        if fit is not None and fit.strength > settled.strength:
            settled, averaged = fit, smooth[fit.best()]
    extrapolated = _extrapolated(averaged, path, moving)
    gripping, at = settled, settled.lags[[settled.best()]]
    few = moving
    # Without a rig the scale is unknown: sliding tyres bias it low, and each iteration excludes more of these rows.
    for _ in range(_ROUNDS if per_unit is None else 1):
        scale = abs(float(gripping.gain[gripping.best()])) if per_unit is None else per_unit
        asked = np.abs(averaged) * path.speed * scale
        with np.errstate(invalid="ignore"):
            few = moving & (asked < max(_GRIPPING, float(np.nanpercentile(asked[moving], 30))))
        gripping = fit_lags(path.yaw_rate, path.forward[:, None], averaged[None], at, few) or gripping
    # yaw rate = gain * (forward * steering - centre * forward): `other` estimates the second coefficient.
    other = fit_lags(path.yaw_rate, averaged[:, None], path.forward[None], at, few)
    if gripping is settled or other is None:
        return settled, settled, extrapolated, 0.0, np.inf
    gain = float(gripping.gain[0])
    return settled, gripping, extrapolated, -float(other.gain[0]) / gain, other.gain_sigma(0) / abs(gain)


def _extrapolated(asked: Float[np.ndarray, " n"], path: DrivenPath, rows: Bool[np.ndarray, " n"]) -> LagFit | None:
    """Fit `asked` to the yaw rate with understeer; None if the result implies oversteer."""
    slip = path.forward**2 * path.yaw_rate
    turn, of_slip = (
        fit_lags(asked, np.stack((path.forward, other), axis=1), one[None], np.zeros(1), rows)
        for one, other in ((path.yaw_rate, slip), (slip, path.yaw_rate))
    )
    if turn is None or of_slip is None or turn.gain[0] * of_slip.gain[0] < 0:
        return None
    return turn


def _averaged(values: Float[np.ndarray, "L ..."], count: int) -> Float[np.ndarray, "m ..."]:
    """Return means over neighbouring lags."""
    return np.asarray(np.lib.stride_tricks.sliding_window_view(values, count, axis=0).mean(axis=-1))


def moving_rows(path: DrivenPath) -> Bool[np.ndarray, " n"]:
    """Return a mask of the rows that are fast enough to show the steering response."""
    return np.asarray(path.speed > max(0.3, 0.2 * path.cruise))


def curvature_per_unit(name: str, rig: Rig) -> float:
    """Return the curvature at a steering of 1 from the rig's geometry [1/m]."""
    return (np.tan(rig.vehicle.max_steer) if name == "steer" else 1.0) / rig.vehicle.wheelbase


def _shifted(values: Float[np.ndarray, "... n"], rows: int) -> Float[np.ndarray, "... n"]:
    """Return the values `rows` later; NaN at the end."""
    end = np.full((*values.shape[:-1], rows), np.nan)
    return np.concatenate((values[..., rows:], end), axis=-1)[..., : values.shape[-1]]


def steering_fits(drive: Drive, path: DrivenPath, *, measured: bool) -> dict[str, SteeringFit]:
    """Return the fits of the steering channels that move in a drive with turns, by name, without frozen samples.

    Args:
        measured: whether wheelbase and `max_steer` were measured, not drafted.
    """
    if np.nanstd(path.yaw_rate) < TURNING:
        return {}
    present = [name for name in ("steer", "steer_angle") if name in drive.channels]
    moved = [name for name in present if np.ptp(drive.channels[name].values) > 0]
    fits = {}
    for name in moved:
        channel = drive.channels[name]
        held = while_held(channel, path, drive.rig, beside=float(LAGS[-1]))
        without = replace(path, yaw_rate=np.where(held, np.nan, path.yaw_rate))
        fits[name] = steering_fit(channel, without, drive.rig, measured=measured)
    return {name: fit for name, fit in fits.items() if fit is not None}
