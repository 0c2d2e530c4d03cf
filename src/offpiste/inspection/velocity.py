"""Checks of recorded velocities against the derivative of the pose: frame, unit, sign and delay."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from offpiste.geometry import rotation_from_quaternion, yaw_rate_from_body_rates
from offpiste.inspection.driven_path import TURNING, Path
from offpiste.inspection.findings import Finding, number
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.rig.channels import ChannelSource

_FITS = 0.2
"""A frame fits if the RMS difference to the pose's derivative is below this share of the RMS speed."""
_LAGS = np.arange(-1.0, 1.01, 0.05)
_UNITS = {"km/h": 3.6, "mph": 2.23694, "kn": 1.94384}
_RATE_UNITS = {"deg/s": 180 / np.pi, "rev/min": 60 / (2 * np.pi)}


@dataclass(frozen=True)
class FrameFit:
    """How well a velocity fits the pose's derivative in one frame.

    Attributes:
        misfit: RMS difference over the RMS speed, with the best gain and delay taken out.
        gain: recorded over true.
        delay: by how much the recorded one is late [s].
    """

    frame: str
    misfit: float
    gain: float
    delay: float


def fit_frames(drive: Drive, path: Path) -> dict[str, FrameFit]:
    """Fits of channel `linear_velocity` by frame, "world" and "body"; empty where too little moves."""
    velocity = drive.channels["linear_velocity"]
    if path.driving < 3:
        return {}
    shifted = _shifted(path, velocity)
    turned = {"world": shifted[:, :2], "body": _world_from_body(drive, path, shifted)}
    return {frame: _best(frame, world, path.velocity.T) for frame, world in turned.items()}


def check_linear_velocity(drive: Drive, path: Path) -> list[Finding]:
    """Frame, unit, sign and delay of the recorded velocity."""
    fits = fit_frames(drive, path)
    if not fits:
        return []
    source = drive.rig.channels["linear_velocity"]
    best = min(fits.values(), key=lambda fit: fit.misfit)
    stated = fits.get(source.frame)
    evidence = ", ".join(f"{fit.misfit:.2f} as {fit.frame}" for fit in fits.values())
    evidence = f"RMS difference to the pose's derivative over RMS speed: {evidence}"
    key = "channels.linear_velocity"
    if best.misfit > 2 * _FITS:
        if source.frame == "unknown":
            return []
        what = "fits the pose in neither frame"
        return [Finding("warning", "linear_velocity", what, evidence, f'{key}.frame = "unknown"', 1.0)]
    findings = []
    if stated is None:
        what = f"its frame is {best.frame}, and could be used"
        findings.append(Finding("note", "linear_velocity", what, evidence, f'{key}.frame = "{best.frame}"', 0.3))
    elif stated.frame != best.frame and stated.misfit > max(_FITS, 2 * best.misfit):
        what = f"is in the {best.frame} frame, not the {stated.frame}'s"
        findings.append(Finding("warning", "linear_velocity", what, evidence, f'{key}.frame = "{best.frame}"', 1.0))
    fit = best if stated is None or findings else stated
    return (
        findings
        + _gain("linear_velocity", fit.gain, source, "m/s", _UNITS)
        + _delay("linear_velocity", fit.delay, fit.misfit, source)
    )


def check_turn_rate(drive: Drive, path: Path) -> list[Finding]:
    """Unit, sign and delay of `yaw_rate`, or of the z component of `angular_velocity`."""
    name = "yaw_rate" if "yaw_rate" in drive.channels else "angular_velocity"
    if name not in drive.channels or np.nanstd(path.yaw_rate) < TURNING:
        return []
    source, rate = drive.rig.channels[name], drive.channels[name]
    recorded = _turn_rate(drive, rate, source)
    scalar = Channel(name, rate.unit, rate.time, recorded[:, None])
    fit = _best("", _shifted(path, scalar), path.yaw_rate[None])
    if fit.misfit > 0.6:
        evidence = f"RMS difference to d(yaw)/dt over its RMS: {fit.misfit:.2f} at the best gain and delay"
        how = f"remove [channels.{name}]: the pose is differentiated instead"
        return [Finding("warning", name, "does not follow the pose's yaw rate", evidence, how, 1.0)]
    return _gain(name, fit.gain, source, "rad/s", _RATE_UNITS) + _delay(name, fit.delay, fit.misfit, source)


def _turn_rate(drive: Drive, rate: Channel, source: ChannelSource) -> Float[np.ndarray, " n"]:
    if rate.values.shape[1] == 1:
        return rate.values[:, 0]
    if source.frame == "body" and "orientation" in drive.channels:
        orientation = drive.channels["orientation"].linear(rate.time, max_gap=np.inf)
        return yaw_rate_from_body_rates(np.nan_to_num(orientation, nan=0.5), rate.values)
    return rate.values[:, 2]


def _shifted(path: Path, recorded: Channel) -> Float[np.ndarray, "L c n"]:
    """Components at the path's times, taken later by each lag; NaN outside of the record."""
    return np.stack(
        [
            [np.interp(path.time + lag, recorded.time, c, left=np.nan, right=np.nan) for c in recorded.values.T]
            for lag in _LAGS
        ]
    )


def _world_from_body(drive: Drive, path: Path, shifted: Float[np.ndarray, "L c n"]) -> Float[np.ndarray, "L 2 n"]:
    """Horizontal world velocity, by the orientation of the moment that each lag assumes it to be of."""
    if shifted.shape[1] == 3 and "orientation" in drive.channels:
        orientation = drive.channels["orientation"].linear(path.time, max_gap=np.inf)
        rotation = rotation_from_quaternion(np.nan_to_num(orientation, nan=0.5))
        world: np.ndarray = np.einsum("nij,Ljn->Lin", rotation[:, :2], shifted)
        return world
    cos, sin = np.cos(path.yaw), np.sin(path.yaw)
    x, y = shifted[:, 0], shifted[:, 1]
    return np.stack((cos * x - sin * y, sin * x + cos * y), axis=1)


def _best(frame: str, sampled: Float[np.ndarray, "L c n"], true: Float[np.ndarray, "c n"]) -> FrameFit:
    """The lag at which `sampled = gain * true` fits best."""
    use = np.isfinite(sampled).all(axis=(0, 1)) & np.isfinite(true).all(axis=0)
    if use.sum() < 40:
        return FrameFit(frame, np.inf, 1.0, 0.0)
    sampled, true = sampled[:, :, use], true[:, use]
    power = np.sum(true**2)
    gain = np.einsum("Lcn,cn->L", sampled, true) / power
    rest = np.sum((sampled - gain[:, None, None] * true) ** 2, axis=(1, 2))
    # Relative to what was recorded, so that a wrong unit does not count as a misfit.
    misfit = np.sqrt(rest / np.maximum(np.sum(sampled**2, axis=(1, 2)), 1e-12))
    i = int(misfit.argmin())
    return FrameFit(frame, float(misfit[i]), float(gain[i]), float(_LAGS[i]))


def _gain(name: str, gain: float, source: ChannelSource, unit: str, units: dict[str, float]) -> list[Finding]:
    findings = []
    evidence = f"it is {gain:.3g} times the pose's derivative"
    if gain < -0.5:
        remedy = f"channels.{name}.sign = {-source.sign}"
        findings.append(Finding("warning", name, "has the wrong sign", evidence, remedy, 1.0))
    size = abs(gain)
    if size < 1e-9:
        how = f"remove [channels.{name}]: the pose is differentiated instead"
        return [Finding("warning", name, "is zero while the vehicle moves", evidence, how, 1.0)]
    if not 0.85 < size < 1.18:
        # A unit that is stated and should not be is as likely as one that should be and is not.
        named = {u: f for u, f in units.items() if abs(size / f - 1) < 0.1 and not source.unit}
        plain = source.unit in units and abs(size * units[source.unit] - 1) < 0.1
        line = (
            f'unit = "{min(named)}"'
            if named
            else f'unit = "{unit}"'
            if plain
            else f"scale = {number(source.scale / size)}"
        )
        serious = not 0.67 < size < 1.5
        findings.append(
            Finding(
                "warning" if serious else "note", name, f"is not in {unit}", evidence, f"channels.{name}.{line}", 0.9
            )
        )
    return findings


def _delay(name: str, delay: float, misfit: float, source: ChannelSource) -> list[Finding]:
    if abs(delay) < 0.12 or misfit > 2 * _FITS:
        return []
    evidence = f"it fits the pose's derivative best when taken {abs(delay):.2f} s {'later' if delay > 0 else 'earlier'}"
    remedy = f"channels.{name}.delay = {number(source.delay + delay)}"
    return [Finding("warning", name, "is late" if delay > 0 else "is early", evidence, remedy, 0.7)]
