"""Checks of the pose: quaternion order, vertical axis, jumps and units."""

from dataclasses import asdict, dataclass
from functools import partial
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

from offpiste.core.conventions import SIGMA_PER_MEDIAN
from offpiste.core.geometry import rotation_from_quaternion
from offpiste.inspection.driven_path import STEP, DrivenPath
from offpiste.inspection.findings import Finding, Severity, found, times
from offpiste.inspection.pose_samples import check_faults, check_repeats, check_seldom
from offpiste.logs.channel import Channel, to_z_up
from offpiste.logs.drive import Drive
from offpiste.rig.channels import GEOGRAPHIC, unit_factor
from offpiste.rig.edits import Edit, rounded
from offpiste.rig.rig import Rig

_UPRIGHT = 0.7
"""Cosine of the maximum plausible tilt in half of a log (45 degrees)."""
_GRIP: Final = 12.0
"""Maximum acceleration that tyres transmit [m/s^2]."""
_FASTEST: Final = 120.0
"""Maximum speed of a ground vehicle [m/s]."""
_HARDEST: Final = 25.0
"""Maximum plausible 95th percentile of the acceleration over half a second [m/s^2]."""
_BESIDE: Final = (0.4, 1.0)
"""Lengths of the segments before and after an instant whose velocities are compared [s]; driving changes the
velocity little over the short ones, and a brief jump little over the long ones."""
_BETWEEN: Final = (0.2, 0.4)
"""Lengths of the gaps between these segments [s]."""
_OTHERS: Final = 3.0
"""Minimum ratio of an outlier to the 95th percentile of the velocity changes."""
_EARTH: Final = (6.34e6, 6.39e6)
"""Range of distances between the ground and the centre of the earth [m]."""
_LARGEST_EASTING: Final = 1e6
"""Maximum UTM easting [m]."""
_JUMP_TIME = 0.05
"""Minimum length of a jump, as the time to drive it at cruising speed [s]."""
_NOISY: Final = 0.03
"""Maximum uncertainty of velocity [m/s] or position [m], as a share of the cruising speed."""
_WIDEST: Final = 1.5
"""Maximum differentiation window for positions [s]."""


def check_orientation(quaternion: Float[np.ndarray, "n 4"], rig: Rig) -> list[Finding]:
    """Check the quaternion order and the direction of up in raw samples."""
    norm = np.linalg.norm(quaternion, axis=1)
    known = quaternion[np.isfinite(norm) & (norm > 1e-6)]
    if len(known) < 10:
        return []
    findings = []
    off = float(np.mean(np.abs(np.linalg.norm(known, axis=1) - 1) > 0.05))
    if off > 0.01:
        severity: Severity = "fatal" if off > 0.5 else "warning"
        about = {"median": np.median(norm)}
        findings.append(found("quaternion_length", "orientation", about, severity=severity, score=off))
    source = rig.channels["orientation"]
    up = _up(to_z_up("orientation", source, known, rig.motion.axes))
    if up > _UPRIGHT:
        return findings
    cures: list[tuple[Edit, ...]] = []
    code = "not_upright"
    if _up(np.roll(known, -1, axis=1)) > 0.9:
        code = "quaternion_order"
        cures.append((Edit("channels.orientation.fields", [*source.fields[1:], source.fields[0]]),))
    if up < -_UPRIGHT:
        code = code if cures else "upside_down"
        cures += [(Edit("motion.axes", axes),) for axes in ("body down", "world down") if axes != rig.motion.axes]
        cures += [(Edit("motion.axes", "z up"),)] if rig.motion.axes != "z up" else []
    return [*findings, found(code, "orientation", {"up": up}, *cures)]


def check_position_unit(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding if positions are in degrees, earth-centred, or in a unit with implausible speeds."""
    places, rig = drive.channels["position"].values, drive.rig
    xy, source = places[:, :2], rig.channels["position"]
    if _is_earth_centred(places):
        x, y, z = (float(each) for each in np.median(places, axis=0))
        about = {"x": x, "y": y, "z": z, "km": np.linalg.norm((x, y, z)) / 1000}
        return [found("earth_centred", "position", about)]
    degrees = np.ptp(xy, axis=0).max() < 0.5 and np.abs(xy).min(axis=1).max() <= 90 and np.abs(xy).max() <= 360
    if degrees and 1e-8 < path.cruise < 1e-3 and np.abs(xy).max() > 1:
        return [_geographic(rig, xy, path)]
    if path.cruise > _FASTEST or _acceleration(path) > _HARDEST:
        now = source.unit or "m"
        fast = {"speed": path.cruise, "acceleration": _acceleration(path), "unit": now}
        per_unit = partial(unit_factor, "position")
        factors = {unit: per_unit(unit) / per_unit(now) for unit in ("cm", "mm", "m", "ft") if unit != now}
        # Units with plausible tyre forces come first.
        units = [unit for unit, factor in factors.items() if _plausible(path, factor)]
        units.sort(key=lambda unit: factors[unit] * _acceleration(path) > _GRIP)
        cures = tuple((Edit("channels.position.unit", unit),) for unit in units) or _scales(rig, path)
        return [found("too_fast", "position", fast, *cures)]
    return []


def _is_earth_centred(places: Float[np.ndarray, "n k"]) -> bool:
    """Return whether positions are earth-centred; a northing may be as large, but not together with its easting."""
    if places.shape[1] < 3:
        return False
    middle = np.abs(np.median(places, axis=0))
    return _EARTH[0] < float(np.linalg.norm(middle)) < _EARTH[1] and float(np.sort(middle)[1]) > _LARGEST_EASTING


def _geographic(rig: Rig, xy: Float[np.ndarray, "n 2"], path: DrivenPath) -> Finding:
    x, y, *height = rig.channels["position"].fields
    unit = Edit("channels.position.unit", GEOGRAPHIC)
    cures: list[tuple[Edit, ...]] = [(unit,), (unit, Edit("channels.position.fields", [y, x, *height]))]
    if "lon" in x.lower() or np.abs(xy[:, 0]).max() > 90:
        cures.reverse()
    if "orientation" in rig.channels and rig.motion.axes == "z up":  # an INS, whose orientation has axes of its own
        cures.insert(1, (*cures[0], Edit("motion.axes", "ned")))
    return found("geographic", "position", {"x": xy[0, 0], "y": xy[0, 1], "speed": path.cruise}, *cures)


def _acceleration(path: DrivenPath) -> float:
    """Return the 95th percentile of the horizontal acceleration over half a second [m/s^2]."""
    rows = round(0.5 / STEP)
    change = np.hypot(*(path.velocity[rows:] - path.velocity[:-rows]).T) / (rows * STEP)
    change = change[np.isfinite(change)]
    return float(np.percentile(change, 95)) if len(change) else 0.0


def _scales(rig: Rig, path: DrivenPath) -> tuple[tuple[Edit, ...], ...]:
    """Return edits of the position scale by powers of ten that make the motion plausible."""
    source = rig.channels["position"]
    factors = [factor for factor in (0.01, 0.001, 0.1) if _plausible(path, factor)]
    return tuple((Edit("channels.position.scale", rounded(source.scale * factor)),) for factor in factors)


def _plausible(path: DrivenPath, factor: float) -> bool:
    """Return whether speed and acceleration are plausible with positions scaled by a factor."""
    return factor * path.cruise < _FASTEST and 0.05 < factor * _acceleration(path) < _HARDEST


def check_pose(drive: Drive, path: DrivenPath, origin: float) -> list[Finding]:
    """Return findings on positions; `origin` is the start time of the log [s]."""
    place = drive.channels["position"]
    seldom = check_repeats(drive, path) + check_seldom(drive)
    noise = [] if seldom else _noise(drive, path)
    return check_faults(drive) + seldom + _jumps(place, path, origin) + _check_leap(path, origin) + noise


def _noise(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Report positions too noisy for initial states or, if the log has no velocity, for differentiation."""
    velocity = drive.rig.channels.get("linear_velocity")
    place = drive.channels["position"]
    if len(place.time) < 100:
        return []
    step = float(np.median(np.diff(place.time)))
    # Third differences of white noise have 20 times its variance; driving contributes little to them.
    sigma = SIGMA_PER_MEDIAN * float(np.median(np.abs(np.diff(place.values[:, :2], 3, axis=0)))) / np.sqrt(20)
    if velocity is not None and velocity.frame != "unknown":
        if sigma < max(_NOISY * path.cruise, 0.02):
            return []
        return [found("noisy", "position", {"sigma": sigma})]
    window = drive.rig.motion.window
    error = sigma * np.sqrt(12 * step / window) / window
    most = max(_NOISY * path.cruise, 0.03)
    if error < most or step > window / 4:
        return []
    wider = round(min(window * (error / most) ** (2 / 3), _WIDEST), 2)
    about = {"sigma": sigma, "window": window, "error": error}
    return [found("too_noisy", "position", about, (Edit("motion.window", wider),))]


def _jumps(place: Channel, path: DrivenPath, origin: float) -> list[Finding]:
    """Return findings on horizontal or vertical steps that the surrounding velocity does not explain."""
    dt = np.diff(place.time)
    if len(dt) < 50:
        return []
    ways = [("", place.values[:, :2])] + [(" of height", place.values[:, 2:])] * (place.values.shape[1] == 3)
    return [finding for words, values in ways if (finding := _jumping(words, values, place.time, path, origin))]


def _jumping(
    words: str, values: Float[np.ndarray, "n k"], time: Float[np.ndarray, " n"], path: DrivenPath, origin: float
) -> Finding | None:
    step, dt = np.diff(values, axis=0), np.diff(time)
    velocity = median_filter(step / dt[:, None], (21, 1), mode="nearest")
    excess = np.linalg.norm(step - velocity * dt[:, None], axis=1)
    least = max(0.1, _JUMP_TIME * path.cruise, 3 * float(np.percentile(excess, 99)))
    jumps = np.flatnonzero((excess > least) & (dt < 1.0))
    if not len(jumps):
        return None
    worst = jumps[excess[jumps].argmax()]
    share = min(5.0 * len(jumps) / (time[-1] - time[0]), 1.0)
    severity: Severity = "warning" if excess[worst] > 2 * least or share > 0.1 else "note"
    when = ", ".join(f"{time[j] - origin:.2f} s" for j in jumps[:5]) + (", ..." if len(jumps) > 5 else "")
    about = {"times": times(len(jumps)), "size": excess[worst], "way": words, "when": when}
    return found("position_jumps", "position", about, severity=severity, score=share)


@dataclass(frozen=True)
class Leap:
    """A sudden and lasting change of velocity.

    Attributes:
        time: [s].
        before, after: speeds [m/s].
    """

    time: float
    before: float
    after: float


def leap_of(path: DrivenPath) -> Leap | None:
    """Return the largest implausible leap of the velocity, or None."""
    sides = [_beside(path, beside, between) for beside, between in zip(_BESIDE, _BETWEEN, strict=True)]
    changes = [np.hypot(*(after - before).T) for before, after in sides]
    change = np.nan_to_num(np.minimum(*changes))
    known = np.isfinite(changes[0])
    if not known.any():
        return None
    at = int(change.argmax())
    # With positions in feet or a noisy pose, all changes are large.
    usual = float(np.percentile(changes[0][known], 95))
    if not change[at] > max(_HARDEST * (_BESIDE[0] + _BETWEEN[0]), _OTHERS * usual):
        return None
    before, after = (float(np.hypot(*side[at])) for side in sides[-1])
    return Leap(float(path.time[at]), before, after)


def _beside(path: DrivenPath, length: float, between: float) -> Float[np.ndarray, "2 n 2"]:
    """Return the median velocities before and after each instant [m/s]; NaN for incomplete segments.

    Args:
        length: of a segment [s].
        between: gap between the segments [s].
    """
    rows, gap = round(length / STEP), round(between / STEP / 2)
    result = np.full((2, len(path.time), 2), np.nan)
    if len(path.time) > 2 * (rows + gap):
        median = np.median(np.lib.stride_tricks.sliding_window_view(path.velocity, rows, axis=0), axis=-1)
        inner = slice(rows + gap, len(path.time) - rows - gap)
        count = inner.stop - inner.start
        result[0, inner], result[1, inner] = median[:count], median[rows + 2 * gap :][:count]
    return result


def _check_leap(path: DrivenPath, origin: float) -> list[Finding]:
    leap = leap_of(path)
    if leap is None:
        return []
    return [found("leap", "position", {**asdict(leap), "time": leap.time - origin})]


def _up(quaternion: Float[np.ndarray, "n 4"]) -> float:
    return float(np.median(rotation_from_quaternion(quaternion)[:, 2, 2]))
