"""Checks of recorded velocities against the derivative of the pose: frame, unit, sign and delay."""

from collections.abc import Iterator
from typing import Final

import numpy as np
from jaxtyping import Float
from msgspec import structs

from offpiste.core.geometry import planar_body_from_world, yaw_rate_from_body_rates
from offpiste.inspection.driven_path import DELAYS, TURNING, DrivenPath, FrameFit, fit_delayed, levelled, on_path
from offpiste.inspection.findings import Finding, found
from offpiste.inspection.lags import SURE, fit_lags
from offpiste.inspection.response import moving_rows
from offpiste.logs.channel import Channel, to_z_up, turning_sign
from offpiste.logs.drive import Drive
from offpiste.rig.channels import GEOGRAPHIC, ChannelSource, unit_factor
from offpiste.rig.edits import Edit, rescaled, rounded
from offpiste.rig.rig import Rig

_FITS = 0.2
"""Maximum RMS difference to the pose's derivative of a matching frame, as a share of the RMS speed."""
_FOLLOWS = 0.6
"""Maximum RMS difference to the pose's yaw rate, as a share of its RMS."""
_LATE: Final = 0.12
"""Minimum delay that is reported [s]."""
_BIASED: Final = 0.02
"""Maximum gyroscope bias [rad/s]."""
_SAME: Final = (0.85, 1.18)
"""Range of gains of a channel in the correct unit."""
_SAME_VELOCITY: Final = (0.92, 1.09)
"""Range of gains of a velocity in the correct unit."""
_SIDEWAYS: Final = 0.5
"""Minimum correlation of identical lateral velocities; 90 fault-free logs are above 0.86."""
_OTHER_BODY: Final = {"z up": "body down", "body down": "z up", "ned": "world down", "world down": "ned"}
"""Axes with the same world frame and the opposite direction of the body's z axis."""
_ROLLING: Final = (0.6, 1.8)
"""Range of wheel speed / vehicle speed, including slip and worn tyres."""
_WITHOUT_SLIP: Final = (0.7, 1.45)
"""The same for wheels that roll without slip, as with another tyre size."""
_PROPORTIONAL: Final = 0.03
"""Maximum misfit of wheels that roll without slip."""
_COUNTED: Final = 0.02
"""Maximum relative deviation of a gain from a power of ten, as for cm/s or mm/s."""
_UNITS = {"km/h": 3.6, "mph": 2.23694, "kn": 1.94384}
_RATE_UNITS = {"deg/s": 180 / np.pi, "rev/min": 60 / (2 * np.pi)}


def fit_frames(drive: Drive, path: DrivenPath) -> dict[str, FrameFit]:
    """Fit the channel `linear_velocity` in the frames "world" and "body"; empty if the motion is insufficient."""
    if path.driving < 3:
        return {}
    recorded = on_path(path, drive.channels["linear_velocity"])
    world, upright = (_read_in(frame, recorded, drive.rig) for frame in ("world", "body"))
    body = planar_body_from_world(path.velocity, path.yaw)
    pairs = {"world": (world[:, :2], path.velocity), "body": (levelled(drive, path, upright), body)}
    fits = {frame: fit_delayed(frame, *pair) for frame, pair in pairs.items()}
    return {frame: fit for frame, fit in fits.items() if fit is not None}


def _read_in(frame: str, velocity: Float[np.ndarray, "n k"], rig: Rig) -> Float[np.ndarray, "n k"]:
    """Return the velocity with z up, read in `frame` instead of the frame in the rig."""
    source, name = rig.channels["linear_velocity"], "linear_velocity"
    recorded = to_z_up(name, source, velocity, rig.motion.axes)  # half a turn is its own inverse
    return to_z_up(name, structs.replace(source, frame=frame), recorded, rig.motion.axes)


def check_linear_velocity(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Check frame, unit, sign and delay of the recorded velocity."""
    name, source = "linear_velocity", drive.rig.channels["linear_velocity"]
    if path.driving >= 3 and not drive.channels[name].values[:, :2].any():
        return [found("zero", name, {}, (Edit(f"channels.{name}", None),))]
    fits = fit_frames(drive, path)
    if not fits:
        return []
    best = min(fits.values(), key=lambda fit: fit.misfit)
    stated = fits.get(source.frame)
    about = {"misfits": ", ".join(f"{fit.misfit:.2f} as {fit.frame}" for fit in fits.values()), "frame": best.frame}
    if best.misfit > 2 * _FITS:
        if source.frame == "unknown":
            return []
        if _fits_north_east(drive, path):
            cure = Edit(f"channels.{name}.fields", [source.fields[1], source.fields[0]])
            edits = (cure,) if source.frame == "world" else (cure, Edit(f"channels.{name}.frame", "world"))
            return [found("velocity_axes", name, about, edits)]
        return [found("velocity_misfit", name, about, (Edit(f"channels.{name}.frame", "unknown"),))]
    findings = []
    mirrored = _sideways(drive, path) if best.frame == "body" else []
    if stated is None and not mirrored:
        findings.append(found("velocity_unused", name, about))
    elif stated is not None and stated.frame != best.frame and stated.misfit > max(_FITS, 2 * best.misfit):
        about["stated"] = stated.frame
        findings.append(found("velocity_frame", name, about, (Edit(f"channels.{name}.frame", best.frame),)))
    if stated is None:
        return findings  # an unused velocity is harmless
    fit = best if findings else stated
    findings += _gain(name, fit, drive.rig, "m/s", _UNITS, _SAME_VELOCITY) + _delay(name, fit, source)
    return findings or mirrored


def _fits_north_east(drive: Drive, path: DrivenPath) -> bool:
    """Return whether the velocity fits the world frame with its first two fields swapped."""
    recorded = _read_in("world", on_path(path, drive.channels["linear_velocity"]), drive.rig)
    fit = fit_delayed("world", recorded[:, 1::-1], path.velocity)
    return fit is not None and fit.misfit < _FITS and fit.gain > 0


def _sideways(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding if the lateral body velocity is opposite to the pose's, i.e. positive to the right."""
    recorded = levelled(drive, path, on_path(path, drive.channels["linear_velocity"]))
    aside = planar_body_from_world(path.velocity, path.yaw)[:, 1]
    fit = fit_lags(aside, np.ones((len(aside), 1)), recorded[None, :, 1], np.zeros(1), moving_rows(path))
    if fit is None or fit.r[0] > -max(_SIDEWAYS, SURE * fit.r_sigma(0)):
        return []
    axes = Edit("motion.axes", _OTHER_BODY[drive.rig.motion.axes])
    unused = Edit("channels.linear_velocity.frame", "unknown")
    about = {"r": fit.r[0], "sigma": fit.r_sigma(0)}
    return [found("velocity_sideways", "linear_velocity", about, (axes,), (unused,))]


def turn_rate_name(drive: Drive) -> str:
    """Return the name of the channel that contains the yaw rate."""
    return "yaw_rate" if "yaw_rate" in drive.channels else "angular_velocity"


def fit_turn_rate(drive: Drive, path: DrivenPath) -> FrameFit | None:
    """Fit the recorded yaw rate to the heading's derivative.

    Return None where no yaw rate is recorded or the vehicle turns too little.
    """
    name = turn_rate_name(drive)
    if name not in drive.channels or np.nanstd(path.yaw_rate) < TURNING:
        return None
    return fit_delayed("", on_path(path, _turn_rate(drive)), path.yaw_rate[:, None])


def fit_wheel_speed(drive: Drive, path: DrivenPath) -> FrameFit | None:
    """Fit the wheel speed to the path's speed; None without wheel speeds or enough motion."""
    if "wheel_speed" not in drive.channels or path.driving < 3:
        return None
    recorded = on_path(path, drive.channels["wheel_speed"]).mean(axis=1)
    return fit_delayed("", *(values[:, None] - np.nanmean(values) for values in (recorded, path.forward)))


def check_wheel_speed(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Check the unit of the wheel speed; wheel slip changes it less than most units do."""
    fit = fit_wheel_speed(drive, path)
    if fit is None or fit.misfit > _FOLLOWS:
        return []
    least, most = _WITHOUT_SLIP if fit.misfit < _PROPORTIONAL else _ROLLING
    if least < abs(fit.gain) < most:
        return []
    # At a nearly constant speed, slip dominates the variation and has another gain.
    recorded = on_path(path, drive.channels["wheel_speed"]).mean(axis=1)
    known = np.isfinite(recorded) & np.isfinite(path.forward)
    level = float(recorded[known] @ path.forward[known]) / max(float(path.forward[known] @ path.forward[known]), 1e-9)
    if not least < level / fit.gain < most:
        return []
    return _gain("wheel_speed", fit, drive.rig, "m/s", _UNITS)


def check_turn_rate(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Check unit, sign and delay of `yaw_rate`, or of the z component of `angular_velocity`."""
    name = turn_rate_name(drive)
    if name not in drive.channels or np.nanstd(path.yaw_rate) < TURNING:
        return []
    if not drive.channels[name].values[:, -1].any():
        return [found("zero", name, {}, (Edit(f"channels.{name}", None),))]
    source, fit = drive.rig.channels[name], fit_turn_rate(drive, path)
    if fit is None:
        return []
    if fit.misfit > _FOLLOWS:
        return [found("rate_misfit", name, {"misfit": fit.misfit}, (Edit(f"channels.{name}", None),))]
    wrong = _gain(name, fit, drive.rig, "rad/s", _RATE_UNITS) + _delay(name, fit, source)
    return wrong or (_bias(on_path(path, drive.channels[name])[:, 0], path, drive.rig) if name == "yaw_rate" else [])


def _bias(recorded: Float[np.ndarray, " n"], path: DrivenPath, rig: Rig) -> list[Finding]:
    """Return a finding if the yaw rate has a significant bias."""
    one, everywhere = np.ones((1, len(recorded))), np.ones(len(recorded), bool)
    fit = fit_lags(recorded, path.yaw_rate[:, None], one, np.zeros(1), everywhere)
    if fit is None or abs(fit.gain[0]) < _BIASED + SURE * fit.gain_sigma(0):
        return []
    name, source, bias = "yaw_rate", rig.channels["yaw_rate"], float(fit.gain[0])
    per_unit = turning_sign(name, rig.motion.axes) * source.sign * unit_factor(name, source.unit)
    edit = Edit(f"channels.{name}.offset", rounded(source.offset - bias / per_unit))
    return [found("rate_bias", name, {"bias": bias, "sigma": fit.gain_sigma(0)}, (edit,))]


def _turn_rate(drive: Drive) -> Channel:
    name = turn_rate_name(drive)
    rate = drive.channels[name]
    if rate.values.shape[1] == 1:
        return rate
    values = rate.values[:, 2]
    if drive.rig.channels[name].frame == "body" and "orientation" in drive.channels:
        orientation = drive.channels["orientation"].linear(rate.time, max_gap=np.inf)
        values = yaw_rate_from_body_rates(np.nan_to_num(orientation, nan=0.5), rate.values)
    return Channel(name, rate.unit, rate.time, values[:, None])


def _gain(
    name: str, fit: FrameFit, rig: Rig, unit: str, units: dict[str, float], same: tuple[float, float] = _SAME
) -> list[Finding]:
    source = rig.channels[name]
    findings, about = [], {"gain": fit.gain, "sigma": fit.gain_sigma, "unit": unit}
    if fit.gain < -SURE * fit.gain_sigma:
        sign = Edit(f"channels.{name}.sign", -source.sign)
        findings.append(found("sensor_sign", name, about, (sign,)))
    size = abs(fit.gain)
    power = float(10.0 ** np.round(np.log10(size))) if size else 1.0
    size = power if abs(size / power - 1) < _COUNTED else size
    if same[0] - SURE * fit.gain_sigma < size < same[1] + SURE * fit.gain_sigma:
        return findings
    # A superfluous unit is as likely as a missing one; joints turn in rad/s.
    named = {u: f for u, f in units.items() if abs(size / f - 1) < 0.1 and not (source.unit or source.joints)}
    plain = source.unit in units and abs(size * units[source.unit] - 1) < 0.1
    value = min(named) if named else unit
    edits = (Edit(f"channels.{name}.unit", value),) if named or plain else rescaled(name, source, 1 / size)
    places = [*_other_unit_of_places(size, rig)] if unit == "m/s" else []
    cures = [edits] if named or plain else [*places, edits]
    cures += [place for place in places if place not in cures]
    if unit == "m/s" and rig.channels["position"].unit != GEOGRAPHIC:
        cures.append((Edit("channels.position.scale", rounded(rig.channels["position"].scale * size)),))
    return [*findings, found("sensor_unit", name, about, *cures)]


def _other_unit_of_places(size: float, rig: Rig) -> Iterator[tuple[Edit, ...]]:
    """Yield units of positions that explain a velocity of `size` times their derivative."""
    source = rig.channels["position"]
    for unit in ("ft", "cm", "mm"):
        if not source.unit and abs(size / unit_factor("position", unit) - 1) < 0.1:
            yield (Edit("channels.position.unit", unit),)


def _delay(name: str, fit: FrameFit, source: ChannelSource) -> list[Finding]:
    if abs(fit.delay) < _LATE + SURE * fit.delay_sigma or abs(fit.delay) >= DELAYS[-1]:
        return []
    edit = Edit(f"channels.{name}.delay", round(source.delay + fit.delay, 2))
    code = "sensor_late" if fit.delay > 0 else "sensor_early"
    return [found(code, name, {"delay": abs(fit.delay), "sigma": fit.delay_sigma}, (edit,))]
