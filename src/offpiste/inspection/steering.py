"""Response to the steering: sign, delay and scale, estimated together.

Two fits see it. The **steady** one explains the yaw rate by speed times steering; the **dynamic** one explains the yaw
rate a moment later by the yaw rate now and the steering in between. A vehicle that drifts countersteers: the steady
relation then turns round or vanishes, but steering to the left still turns it further to the left than it would go.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.inspection.course import leans_inward
from offpiste.inspection.driven_path import STEP, TURNING, Path
from offpiste.inspection.findings import Finding
from offpiste.inspection.lags import LAGS, SURE, LagFit, fit_lags, lagged
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.rig.edits import Edit, absent, number, rounded
from offpiste.rig.rig import Rig

_AHEAD: Final = 0.2
"""The dynamic fit explains the yaw rate this much later [s]."""
_STEADY_OWN: Final = (-0.08, 0.5)
_DYNAMIC_OWN: Final = (-0.12, 0.4)
"""Delays of the turning that are the vehicle's own, as either fit shows them [s]."""
_USUAL: Final = {"steer": 0.05, "steer_angle": 0.0}
"""Delay in the dynamic fit that is left when a wrong one is taken out [s]: actuators take a moment."""
_STEADY_EFFECT: Final = 0.5
_DYNAMIC_EFFECT: Final = 0.3
"""Correlations above which there is an effect."""
_CLEAR: Final = 0.7
"""Correlation of the steady fit above which scale and changes of the delay are clear."""
_WINDOW: Final = 8.0
"""Length of a stretch whose delay is estimated by itself [s]."""
_SHARES: Final = (0.5, 1.25)
"""Turning over what the wheels' angle asks for: 0.56 to 1.1 in healthy drives, on ice and with much slip, too."""
_USUAL_SHARE: Final = 0.85
"""The share that a remedy assumes: tyres slip, and quick steering is followed in part only."""
_GRIPPING: Final = 3.0
"""Lateral acceleration up to which tyres follow their wheels [m/s^2]."""
_ROUNDS: Final = 5
"""Rounds in which the scale of the steering, and with it the rows where tyres grip, come to rest."""
_SHAPES: Final = (1.0, 2.8)
"""Wheelbases in tracks that vehicles have."""


@dataclass(frozen=True)
class SteeringFit:
    """Both fits of a steering channel, and the steady one on the rows where little cornering is asked for.

    Attributes:
        steady, dynamic: over all moving rows.
        gripping: the steady fit where speed and steering, not the turning, ask for little lateral acceleration; its
            gain is the scale. The same as `steady` where there are too few such rows.
    """

    steady: LagFit
    dynamic: LagFit
    gripping: LagFit

    @property
    def has_effect(self) -> bool:
        """Whether the steering turns the vehicle, in either direction."""
        return _best_r(self.steady) >= _STEADY_EFFECT or _best_r(self.dynamic) >= _DYNAMIC_EFFECT

    @property
    def sign(self) -> int:
        """Sign of the effect, 0 where it is not clear: the dynamic fit decides if the two differ."""
        steady, dynamic = (_sure_sign(fit) for fit in (self.steady, self.dynamic))
        if steady == dynamic or not dynamic:
            return steady
        return dynamic if _best_r(self.dynamic) >= _DYNAMIC_EFFECT else 0


def _best_r(fit: LagFit) -> float:
    return float(abs(fit.r[fit.best()]))


def _sure_sign(fit: LagFit) -> int:
    best = fit.best()
    return int(np.sign(fit.r[best])) if abs(fit.r[best]) > SURE * fit.r_sigma(best) else 0


def steering_fit(channel: Channel, path: Path, rig: Rig, *, measured: bool) -> SteeringFit | None:
    """Fit of the yaw rate by forward speed times steering (its tangent, if it is an angle), with a free centre."""
    angle = lagged(channel, path.time, rig)
    wheel = np.tan(np.clip(angle, -1.4, 1.4)) if channel.name == "steer_angle" else angle
    turning = path.forward * wheel
    moving = path.speed > max(0.3, 0.2 * path.cruise)
    steady = fit_lags(path.yaw_rate, path.forward[:, None], turning, LAGS, moving)
    later = round(_AHEAD / STEP)
    then = _shifted(path.forward, later)
    base = np.stack((path.yaw_rate, then), axis=1)
    dynamic = fit_lags(_shifted(path.yaw_rate, later), base, _shifted(turning, later), LAGS, moving)
    if steady is None or dynamic is None:
        return None
    gripping = steady
    # Without a rig the scale is what is sought: tyres that slide show too small a one, and each round fewer of them.
    for _ in range(1 if measured else _ROUNDS):
        scale = _per_unit(channel.name, rig) if measured else abs(float(gripping.gain[gripping.best()]))
        asked = np.abs(turning[steady.best()]) * path.speed * scale
        with np.errstate(invalid="ignore"):
            few = asked < max(_GRIPPING, float(np.nanpercentile(asked[moving], 30)))
        gripping = fit_lags(path.yaw_rate, path.forward[:, None], turning, LAGS, moving & few) or gripping
    return SteeringFit(steady, dynamic, gripping)


def _per_unit(name: str, rig: Rig) -> float:
    """Curvature at a steering of 1, by the rig's geometry [1/m]."""
    return (np.tan(rig.vehicle.max_steer) if name == "steer" else 1.0) / rig.vehicle.wheelbase


def _shifted(values: Float[np.ndarray, "... n"], rows: int) -> Float[np.ndarray, "... n"]:
    """The values some rows later; NaN at the end."""
    end = np.full((*values.shape[:-1], rows), np.nan)
    return np.concatenate((values[..., rows:], end), axis=-1)


def check_steering(fits: Mapping[str, SteeringFit], drive: Drive, path: Path, *, measured: bool) -> list[Finding]:
    """Findings on `steer` and `steer_angle`.

    Args:
        fits: of `steering_fits`.
        measured: whether the rig's wheelbase and `max_steer` are the vehicle's, not a draft's.
    """
    findings: list[Finding] = []
    for name, fit in fits.items():
        if not fit.has_effect:
            findings.append(_without_effect(name, fit, drive.rig))
            continue
        findings += _sign(name, fit, drive, path)
        changing = _changing_delay(name, drive.channels[name], path, drive.rig)
        findings += changing or _delay(name, fit, drive.rig)
        findings += _scale(name, fit, drive.rig) if measured else _radius(name, fit)
    return findings


def steering_fits(drive: Drive, path: Path, *, measured: bool) -> dict[str, SteeringFit]:
    """Fits of the steering channels that move in a drive that turns, by name; `measured` as in `check_steering`."""
    if np.nanstd(path.yaw_rate) < TURNING:
        return {}
    present = [name for name in ("steer", "steer_angle") if name in drive.channels]
    moved = [name for name in present if np.ptp(drive.channels[name].values) > 0]
    fits = {name: steering_fit(drive.channels[name], path, drive.rig, measured=measured) for name in moved}
    return {name: fit for name, fit in fits.items() if fit is not None}


def _without_effect(name: str, fit: SteeringFit, rig: Rig) -> Finding:
    steady, dynamic = fit.steady, fit.dynamic
    evidence = f"correlation of the yaw rate with speed times {name}: {steady.r[steady.best()]:.2f} at best, "
    evidence += f"{dynamic.r[dynamic.best()]:.2f} with the change of the yaw rate, within 1.5 s"
    other = "look for another field; no model can do without steering"
    cures: tuple[tuple[Edit, ...], ...] = ()
    if name != "steer":
        other = f'look for another field, or absent = ["{name}"]'
        cures = (absent(name, rig),)
    return Finding("warning", name, "does not turn the vehicle", evidence, other, 1.0, cures)


def _sign(name: str, fit: SteeringFit, drive: Drive, path: Path) -> list[Finding]:
    if fit.sign >= 0:
        return []
    steady, dynamic = fit.steady, fit.dynamic
    evidence = f"correlation of the yaw rate (+ left) with speed times {name}: {steady.r[steady.best()]:+.2f}, "
    evidence += f"of its change {dynamic.r[dynamic.best()]:+.2f}"
    cures = [(Edit(f"channels.{name}.sign", -drive.rig.channels[name].sign),)]
    # Poses whose z points down are seen in a mirror; the body's lean tells them from a steering to the right.
    if leans_inward(drive, path):
        cures.insert(0, (Edit("motion.axes", "ned" if drive.rig.motion.axes == "z up" else "z up"),))
    remedy = str(cures[0][0])
    return [Finding("warning", name, "is positive to the right", evidence, remedy, 1.0, tuple(cures))]


def _delay(name: str, fit: SteeringFit, rig: Rig) -> list[Finding]:
    """A finding if both fits show a delay that is not the vehicle's own."""
    lags = []
    for part, own, clear in ((fit.steady, _STEADY_OWN, _CLEAR), (fit.dynamic, _DYNAMIC_OWN, _DYNAMIC_EFFECT)):
        best = part.best(sign=fit.sign)
        if best in (0, len(LAGS) - 1) or abs(part.r[best]) < clear:
            return []
        lag, sigma = part.delay(best)
        if max(own[0] - lag, lag - own[1]) < SURE * sigma:
            return []
        lags.append((lag, sigma))
    (steady, _), (dynamic, sigma) = lags
    if steady * dynamic < 0:
        return []
    when = "before" if dynamic < 0 else "after"
    evidence = f"the turning comes {abs(dynamic):.2f} ± {sigma:.2f} s {when} it"
    what = "is stamped after the motion that it causes" if dynamic < 0 else "comes long before the motion"
    delay = round(rig.channels[name].delay - dynamic + _USUAL[name], 2)
    edit = Edit(f"channels.{name}.delay", delay)
    remedy = str(edit) + ("; if it is called a command, it is a copy of a measurement" if dynamic < 0 else "")
    severe = dynamic < 0 or dynamic > 1
    return [Finding("warning" if severe else "note", name, what, evidence, remedy, min(abs(dynamic), 1.0), ((edit,),))]


def _scale(name: str, fit: SteeringFit, rig: Rig) -> list[Finding]:
    """Yaw rate over speed is tan(angle) / wheelbase, where tyres grip."""
    # Of both fits the one nearer to the rig: tyres that slide spoil one, little steering the other.
    gains = [(abs(float(part.gain[part.best()])), part) for part in (fit.gripping, fit.steady)]
    gain, part = min(gains, key=lambda pair: abs(np.log(max(pair[0], 1e-9) / _per_unit(name, rig))))
    sigma = part.gain_sigma(part.best())
    if _best_r(fit.gripping) < _CLEAR or _best_r(fit.steady) < _CLEAR or not sigma < 0.2 * gain:
        return []
    factor = gain / _per_unit(name, rig)
    margin = 1.5 * factor * sigma / gain
    if _SHARES[0] - margin < factor < _SHARES[1] + margin:
        return []
    implied = gain * rig.vehicle.wheelbase / _USUAL_SHARE
    evidence = f"yaw rate and a wheelbase of {rig.vehicle.wheelbase:.2f} m imply "
    if name == "steer":
        angle, stated = float(np.arctan(implied)), rig.vehicle.max_steer
        evidence += f"{angle:.3f} rad at steer = 1; the rig says {stated:.3f} rad"
        edit = Edit("vehicle.max_steer", rounded(angle))
    else:
        source = rig.channels[name]
        evidence += f"{implied:.3g} times the angle"
        edit = Edit(f"channels.{name}.scale", rounded(source.scale * implied))
        if abs(implied * 180 / np.pi - 1) < 0.4:
            edit = Edit(f"channels.{name}.unit", "deg")
        elif source.unit == "deg" and abs(implied * np.pi / 180 - 1) < 0.4:
            edit = Edit(f"channels.{name}.unit", "rad")
    longer = _USUAL_SHARE / factor
    wheelbase = _other_wheelbase(rig, longer)
    cures: tuple[tuple[Edit, ...], ...] = ((edit,),)
    remedy = str(edit)
    if wheelbase is not None:
        cures = (*cures, (wheelbase,))
        remedy += f"; or the wheelbase is {rig.vehicle.wheelbase * longer:.2f} m: {wheelbase}"
    what = "turns the vehicle more than the rig says" if factor > 1 else "turns the vehicle less than the rig says"
    return [Finding("warning", name, what, evidence, remedy, 0.6, cures)]


def _other_wheelbase(rig: Rig, factor: float) -> Edit | None:
    """Wheel positions whose wheelbase is `factor` times as long; None where no vehicle has that shape."""
    vehicle = rig.vehicle
    if not _SHAPES[0] < factor * vehicle.wheelbase / max(vehicle.track, 1e-6) < _SHAPES[1]:
        return None
    places = [[rounded(x * factor), y] for x, y in vehicle.wheel_positions]
    return Edit("vehicle.wheel_positions", places)


def _radius(name: str, fit: SteeringFit) -> list[Finding]:
    """The scale of the steering where no wheelbase is known."""
    curvature = abs(float(fit.gripping.gain[fit.gripping.best()]))
    evidence = f"yaw rate / speed = {curvature:.3g} 1/m times {name}: a radius of {1 / curvature:.1f} m at {name} = 1"
    line = f"vehicle.max_steer = atan({number(curvature)} * wheelbase); somewhat more where tyres slid all along"
    remedy = line if name == "steer" else "compare with tan(angle) / wheelbase"
    return [Finding("note", name, "has this scale", evidence, remedy, 0.4)]


def _changing_delay(name: str, channel: Channel, path: Path, rig: Rig) -> list[Finding]:
    """A warning if the delay differs between stretches of the drive in which it turns enough."""
    lags = _window_lags(channel, path, rig)
    if len(lags) < 5:
        return []
    low, middle, high = np.percentile(lags, (10, 50, 90))
    if high - low < 0.35 or low > -0.2:
        return []
    evidence = (
        f"the motion comes {low:+.2f} to {high:+.2f} s after it (10 to 90 %, median {middle:+.2f}) in {len(lags)} "
    )
    evidence += f"stretches of {_WINDOW:.0f} s"
    how = "use another source for it (a command that follows the motion is a late copy), or align its clock"
    return [Finding("warning", name, "has a delay that changes", evidence, how + " with [alignment]", 0.9)]


def _window_lags(channel: Channel, path: Path, rig: Rig) -> Float[np.ndarray, " w"]:
    turning = path.forward * lagged(channel, path.time, rig)
    result = []
    usual = np.nanstd(path.yaw_rate[path.speed > max(0.3, 0.2 * path.cruise)])
    for start in np.arange(path.time[0], path.time[-1] - _WINDOW, _WINDOW):
        rows: Bool[np.ndarray, " n"] = (path.time >= start) & (path.time < start + _WINDOW)
        if not np.isfinite(path.yaw_rate[rows]).any() or np.nanstd(path.yaw_rate[rows]) < 0.7 * usual:
            continue
        fit = fit_lags(path.yaw_rate, path.forward[:, None], turning, LAGS, rows)
        if fit is None:
            continue
        best = fit.best()
        if abs(fit.r[best]) > 0.93 and 0 < best < len(LAGS) - 1:
            result.append(float(LAGS[best]))
    return np.array(result)
