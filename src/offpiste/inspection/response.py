"""Responses of the vehicle to its controls: sign, delay, gain and centre, each with its uncertainty.

All estimates are partial regressions over candidate lags with a block jackknife (`lags.py`); `PRIORS` states what
fault-free vehicles do. Steering has three fits. The **steady** fit explains the yaw rate by speed times steering. The
**dynamic** fit explains the yaw rate a moment later by the current yaw rate and the steering in between: a drifting
vehicle countersteers, so that the steady relation vanishes or changes its sign, but steering to the left still
increases the yaw rate. The **settled** fit is the steady one of moving averages at little lateral acceleration, where
neither slow actuators nor sliding tyres change the gain.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtr, stdtrit

from offpiste.inspection.driven_path import STEP, TURNING, DrivenPath
from offpiste.inspection.held import while_held
from offpiste.inspection.lags import LAGS, SURE, LagFit, fit_lags, jackknife, lagged, sampled
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.rig.labels import is_measured_steering
from offpiste.rig.rig import Rig


@dataclass(frozen=True)
class Prior:
    """Response of fault-free vehicles to a control.

    Attributes:
        sign: of the effect on the acceleration; 0 for steering, as poses may be mirrored.
        usual, spread: mean and standard deviation of the delay [s].
        delays: plausible delays, caused by actuators, powertrain, brakes and tyres [s].
        effect: minimum correlation that indicates an effect.
        clear: minimum correlation for estimating a delay.
    """

    sign: int
    usual: float
    spread: float
    delays: tuple[float, float]
    effect: float
    clear: float


PRIORS: Final = {
    #             sign usual spread delays        effect clear
    "steer": Prior(0, 0.12, 0.07, (-0.12, 0.40), 0.3, 0.3),
    "steer_angle": Prior(0, 0.0, 0.07, (-0.12, 0.20), 0.3, 0.3),
    "throttle": Prior(1, 0.10, 0.15, (-0.07, 0.80), 0.2, 0.3),
    "brake": Prior(-1, 0.06, 0.15, (-0.07, 0.50), 0.2, 0.3),
}
"""Priors by channel; a measured angle that is read as `steer` responds like `steer_angle`."""
PEDALS: Final = ("throttle", "brake")
_STEADY_EFFECT: Final = 0.5
"""Minimum correlation of the steady fit that indicates an effect."""
_NO_DRIFT: Final = 0.95
"""Minimum correlation of the steady fit of a vehicle that does not drift."""
_AHEAD: Final = 0.2
"""Time from the regressors to the yaw rate in the dynamic fit [s]."""
_AVERAGED: Final = 1.0
"""Averaging time of the settled fit [s]."""
_GRIPPING: Final = 2.0
"""Maximum lateral acceleration with little tyre slip [m/s^2]."""
_LEAST_GRIPPING: Final = 30
"""Minimum share of the rows in the settled fit [%]."""


def prior(name: str, rig: Rig) -> Prior:
    """Return the prior of a control as it is read by a rig."""
    return PRIORS["steer_angle" if name == "steer" and is_measured_steering(name, rig) else name]


@dataclass(frozen=True)
class Gain:
    """Absolute gain of one signal per unit of another.

    Attributes:
        value, sigma: estimate and the standard deviation of its logarithm.
        strength: partial correlation.
    """

    value: float
    sigma: float
    strength: float


@dataclass(frozen=True)
class SteeringFit:
    """Fits of a steering channel; gains are curvatures in 1/m per unit (for angles, of the tangent).

    Attributes:
        steady, dynamic: fits to all moving rows.
        settled: fit of moving averages at little lateral acceleration.
        without_slip: gain extrapolated to zero speed, as understeer grows with speed; None if unknown.
        centre, centre_sigma: steering for driving straight and its standard deviation; 0 and infinity if unknown.
    """

    steady: LagFit
    dynamic: LagFit
    settled: LagFit
    without_slip: Gain | None
    centre: float
    centre_sigma: float

    @property
    def has_effect(self) -> bool:
        """Return whether the steering turns the vehicle, in either direction."""
        return self.steady.strength >= _STEADY_EFFECT or self.dynamic.strength >= PRIORS["steer"].effect

    @property
    def sign(self) -> int:
        """Sign of the effect, 0 if unclear; if the fits differ, as in a drift, the dynamic fit decides."""
        steady, dynamic = (_sure_sign(fit) for fit in (self.steady, self.dynamic))
        if steady == dynamic or not dynamic or (steady and self.steady.strength > _NO_DRIFT):
            return steady
        return dynamic if self.dynamic.strength >= PRIORS["steer"].effect else 0

    @property
    def curvature(self) -> Gain:
        """Curvature per unit of steering in the settled fit, attributing its scatter to the yaw rate."""
        return reverse_gain(self.settled)


def reverse_gain(fit: LagFit) -> Gain:
    """Return the target per unit of the source at the best lag, from the regression of the source on the target."""
    best = fit.best()
    gain, r = abs(float(fit.gain[best])), float(fit.r[best])
    left_out = np.abs(fit.gain_left_out[:, best]) / fit.left_out[:, best] ** 2
    return Gain(gain / r**2, jackknife(np.log(left_out)), abs(r))


def _sure_sign(fit: LagFit) -> int:
    best, blocks = fit.best(), len(fit.left_out)
    # With few blocks, use Student's t at the significance of `SURE` in a normal distribution.
    sure = stdtrit(blocks - 1, ndtr(SURE)) if blocks > 1 else np.inf
    return int(np.sign(fit.r[best])) if abs(fit.r[best]) > sure * fit.r_sigma(best) else 0


def steering_fit(channel: Channel, path: DrivenPath, rig: Rig) -> SteeringFit | None:
    """Fit the yaw rate to forward speed times steering (the tangent of an angle); None with too little motion."""
    angle = lagged(channel, path.time, rig)
    turning = path.forward * (np.tan(np.clip(angle, -1.4, 1.4)) if channel.name == "steer_angle" else angle)
    moving = moving_rows(path)
    steady = fit_lags(path.yaw_rate, path.forward[:, None], turning, LAGS, moving)
    later = round(_AHEAD / STEP)
    base = np.stack((path.yaw_rate, _shifted(path.forward, later)), axis=1)
    dynamic = fit_lags(_shifted(path.yaw_rate, later), base, _shifted(turning, later), LAGS, moving)
    if steady is None or dynamic is None:
        return None
    averaged_turning = averaged(turning)
    rate, forward, slip = averaged(np.stack((path.yaw_rate, path.forward, path.forward**2 * path.yaw_rate)))
    gripping = _gripping(rate * forward, moving)
    settled = fit_lags(rate, forward[:, None], averaged_turning, LAGS, gripping)
    if settled is None:
        return SteeringFit(steady, dynamic, steady, None, 0.0, np.inf)
    asked = averaged_turning[settled.best()]
    # yaw rate = gain * (forward * steering - centre * forward): `straight` estimates the second coefficient.
    straight = fit_lags(rate, asked[:, None], forward[None], np.zeros(1), gripping)
    centre, sigma = (0.0, np.inf) if straight is None else (-float(straight.gain[0]), straight.gain_sigma(0))
    gain = float(settled.gain[settled.best()])
    without_slip = _without_slip(asked, rate, forward, slip, moving)
    return SteeringFit(steady, dynamic, settled, without_slip, centre / gain, sigma / abs(gain))


def _without_slip(
    asked: Float[np.ndarray, " n"],
    rate: Float[np.ndarray, " n"],
    forward: Float[np.ndarray, " n"],
    slip: Float[np.ndarray, " n"],
    rows: Bool[np.ndarray, " n"],
) -> Gain | None:
    """Fit yaw rate = gain * asked / (1 + K speed^2), for the gain; None if the result implies oversteer."""
    turn, understeer = (
        fit_lags(asked, np.stack((forward, other), axis=1), one[None], np.zeros(1), rows)
        for one, other in ((rate, slip), (slip, rate))
    )
    if turn is None or understeer is None or turn.gain[0] * understeer.gain[0] < 0:
        return None
    gain = abs(float(turn.gain[0]))
    return Gain(1 / gain, turn.gain_sigma(0) / gain, turn.strength)


def _gripping(lateral: Float[np.ndarray, " n"], moving: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return the moving rows with little lateral acceleration, at least `_LEAST_GRIPPING` of them."""
    size = np.abs(lateral)
    known = size[moving & np.isfinite(size)]
    limit = max(_GRIPPING, float(np.percentile(known, _LEAST_GRIPPING))) if len(known) else 0.0
    with np.errstate(invalid="ignore"):
        return np.asarray(moving & (size < limit))


def averaged(values: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "... n"]:
    """Return centred moving averages over 1 s, as actuators follow fast steering only partly; NaN beside unknowns."""
    count = round(_AVERAGED / STEP) + 1
    result = np.full(values.shape, np.nan)
    if values.shape[-1] >= count:
        windows = np.lib.stride_tricks.sliding_window_view(values, count, axis=-1)
        result[..., count // 2 : values.shape[-1] - count // 2] = windows.mean(axis=-1)
    return result


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


def steering_fits(drive: Drive, path: DrivenPath) -> dict[str, SteeringFit]:
    """Return the fits of the steering channels that move in a drive with turns, by name, without frozen samples."""
    if np.nanstd(path.yaw_rate) < TURNING:
        return {}
    fits = {}
    for name in ("steer", "steer_angle"):
        if name in drive.channels and np.ptp(drive.channels[name].values) > 0:
            channel = drive.channels[name]
            held = while_held(channel, path, drive.rig, beside=float(LAGS[-1]))
            without = replace(path, yaw_rate=np.where(held, np.nan, path.yaw_rate))
            fits[name] = steering_fit(channel, without, drive.rig)
    return {name: fit for name, fit in fits.items() if fit is not None}


def turn_rate_fit(channel: Channel, path: DrivenPath, rig: Rig, steering: SteeringFit | None) -> LagFit | None:
    """Fit the yaw rate to a channel itself; None if the channel times the speed explains more.

    Args:
        steering: the fit of the channel as a steering.
    """
    fit = fit_lags(
        path.yaw_rate, np.ones((len(path.time), 1)), lagged(channel, path.time, rig), LAGS, moving_rows(path)
    )
    return None if fit is None or (steering is not None and fit.strength < steering.steady.strength) else fit


def pedal_fits(drive: Drive, path: DrivenPath) -> dict[str, LagFit]:
    """Return the fits of all pedals that move, by name."""
    fits = {}
    for name, other in (PEDALS, PEDALS[::-1]):
        if name in drive.channels and np.ptp(drive.channels[name].values) > 0:
            fits[name] = pedal_fit(drive.channels[name], drive.channels.get(other), path, drive.rig)
    return {name: fit for name, fit in fits.items() if fit is not None}


def pedal_fit(channel: Channel, other: Channel | None, path: DrivenPath, rig: Rig) -> LagFit | None:
    """Fit the acceleration along the direction of travel to a pedal, given drag, slope and the other pedal."""
    base = [np.ones(len(path.time)), np.abs(path.forward), path.forward**2, path.slope]
    if other is not None and np.ptp(other.values) > 0:
        base.append(sampled(other, path.time - 0.2, rig))
    pedal, gained = lagged(channel, path.time, rig), path.acceleration * np.sign(path.forward)
    return fit_lags(gained, np.stack(base, axis=1), pedal, LAGS, path.speed > 0.3)
