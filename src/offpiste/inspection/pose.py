"""Checks of the pose: order of the quaternion, which way is up, heading against course, jumps, units."""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

from offpiste.geometry import rotation_from_quaternion
from offpiste.inspection.driven_path import Path
from offpiste.inspection.findings import Finding, number
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.logs.motion import heading
from offpiste.rig.rig import Rig

_UPRIGHT = 0.7
"""Cosine of the tilt that no vehicle drives at for half of a log: 45 degrees."""
_FASTEST = 60.0
"""No ground vehicle here is faster [m/s]."""
_TOGETHER = 0.8
"""Resultant of angles that agree: a circular spread of some 40 degrees."""
_JUMP_TIME = 0.05
"""A jump is at least as long as the path driven in this time at cruising speed [s]."""


def check_orientation(quaternion: Float[np.ndarray, "n 4"], rig: Rig) -> list[Finding]:
    """The order of the quaternion and the direction of up, from the raw rows in the rig's order."""
    norm = np.linalg.norm(quaternion, axis=1)
    known = quaternion[np.isfinite(norm) & (norm > 1e-6)]
    if len(known) < 10:
        return []
    findings = []
    off = float(np.mean(np.abs(np.linalg.norm(known, axis=1) - 1) > 0.05))
    if off > 0.01:
        findings.append(
            Finding(
                "fatal" if off > 0.5 else "warning",
                "orientation",
                "quaternions are not of length 1",
                f"{off:.1%} of them; the median length is {np.median(norm):.3g}",
                "fix channels.orientation.fields; such rows are dropped on reading",
                off,
            )
        )
    up = _up(known)
    if up > _UPRIGHT:
        return findings
    source = rig.channels["orientation"]
    if _up(np.roll(known, -1, axis=1)) > 0.9:
        fields = ", ".join(f'"{f}"' for f in source.fields[1:] + source.fields[:1])
        what, remedy = "the quaternion is stored as w x y z", f"channels.orientation.fields = [{fields}]"
    elif up < -_UPRIGHT:
        what, remedy = "the body's z axis points down (NED)", "convert the pose to x forward, y left, z up"
    else:
        what, remedy = "the body's z axis does not point up", "take another pose, or turn this one to z up"
    evidence = f"the median z component of the body's z axis is {up:.2f} where a vehicle's is near 1"
    return [*findings, Finding("fatal", "orientation", what, evidence, remedy, 1.0)]


def check_position_unit(drive: Drive, path: Path) -> list[Finding]:
    """Degrees of latitude and longitude, or a unit in which no vehicle is that fast."""
    xy, rig = drive.channels["position"].values[:, :2], drive.rig
    degrees = np.ptp(xy, axis=0).max() < 0.5 and np.abs(xy[:, 0]).max() <= 90 and np.abs(xy[:, 1]).max() <= 180
    if degrees and 1e-8 < path.cruise < 1e-3 and np.abs(xy).max() > 1:
        evidence = f"around ({xy[0, 0]:.5f}, {xy[0, 1]:.5f}), moving by {path.cruise:.1e} a second"
        how = "project it to a local frame (UTM, ENU), or take another pose"
        return [Finding("fatal", "position", "looks like latitude and longitude", evidence, how, 1.0)]
    if path.cruise > _FASTEST:
        now = rig.channels["position"].unit or "m"
        unit = "mm" if path.cruise > 20 * _FASTEST else "cm"
        evidence = f"95 % of the speeds reach {path.cruise:.0f} m/s, read as {now}"
        return [Finding("fatal", "position", "moves too fast", evidence, f'channels.position.unit = "{unit}"', 1.0)]
    return []


def check_pose(drive: Drive, path: Path, origin: float) -> list[Finding]:
    """Findings on positions and headings; `origin` is where the log's time starts [s]."""
    place = drive.channels["position"]
    return _jumps(place, path, origin) + _level(place) + _course(drive, path)


def heading_fits(path: Path) -> bool:
    """Whether the heading follows the course, so that turning and steering can be checked by it."""
    return _resultant(path, 1.0) > _TOGETHER


def _jumps(place: Channel, path: Path, origin: float) -> list[Finding]:
    """Steps that the speed before and after does not explain."""
    step = np.diff(place.values[:, :2], axis=0)
    dt = np.diff(place.time)
    if len(dt) < 50:
        return []
    speed = median_filter(np.hypot(*step.T) / dt, 21, mode="nearest")
    excess = np.hypot(*step.T) - speed * dt
    least = max(0.1, _JUMP_TIME * path.cruise, 3 * float(np.percentile(excess, 99)))
    jumps = np.flatnonzero((excess > least) & (dt < 1.0))
    if not len(jumps):
        return []
    worst = jumps[excess[jumps].argmax()]
    share = min(5.0 * len(jumps) / (place.time[-1] - place.time[0]), 1.0)
    serious = excess[worst] > 2 * least or share > 0.1
    when = ", ".join(f"{place.time[j] - origin:.2f} s" for j in jumps[:5]) + (", ..." if len(jumps) > 5 else "")
    return [
        Finding(
            "warning" if serious else "note",
            "position",
            "jumps",
            f"{len(jumps)} times, by up to {excess[worst]:.2f} m between two samples; at {when}",
            "no rig line fixes it: cut the log there, or take a pose without corrections (odometry, not SLAM or GPS)",
            share,
        )
    ]


def _level(place: Channel) -> list[Finding]:
    if place.values.shape[1] < 3:
        return []
    spread = np.ptp(np.stack([median_filter(c, 11, mode="nearest") for c in place.values.T], axis=1), axis=0)
    if spread[2] < 0.7 * np.hypot(*spread[:2]) or spread[2] < 1:
        return []
    evidence = f"x, y, z span {spread[0]:.1f}, {spread[1]:.1f}, {spread[2]:.1f} m"
    how = "reorder channels.position.fields so that z is up, or take another pose (this may be a camera's frame)"
    return [Finding("warning", "position", "climbs as much as it drives", evidence, how, 0.9)]


def _course(drive: Drive, path: Path) -> list[Finding]:
    """Heading against the direction of travel."""
    moving = _moving(path)
    if moving.sum() < 40:
        return []
    channel = "yaw" if "yaw" in drive.channels else "orientation"
    fits = _resultant(path, 1.0)
    if fits > _TOGETHER:
        off = _mean_difference(path)
        if abs(off) < np.radians(15):
            return []
        evidence = f"{np.degrees(off):.0f} degrees on average while moving"
        if abs(off) > np.radians(150):
            how = "turn the pose by 180 degrees, unless it drove backwards"
        else:
            how = "turn the pose to x forward"
        if channel == "yaw":
            offset = drive.rig.channels["yaw"].sign * off + drive.rig.channels["yaw"].offset
            how = f"channels.yaw.offset = {number(offset)}" if not drive.rig.channels["yaw"].unit else how
        return [Finding("warning", channel, "the heading is turned against the course", evidence, how, 0.8)]
    return [_heading_apart(drive, path, channel, fits)]


def _heading_apart(drive: Drive, path: Path, channel: str, fits: float) -> Finding:
    tried = {"sign": -1.0, "deg": np.pi / 180, "rad": 180 / np.pi}
    raw = heading(drive)
    if channel == "yaw":
        # Degrees read as radians were unwrapped at the wrong turn: go back to the samples.
        raw = drive.channels["yaw"]
    result = {}
    for name, factor in tried.items():
        yaw = np.interp(path.time, raw.time, np.unwrap(raw.values[:, 0] * factor))
        result[name] = _resultant(path, 1.0, yaw)
    best = max(result, key=lambda name: result[name])
    evidence = f"they agree to {fits:.2f} (1: always, 0: never)"
    if result[best] < _TOGETHER or channel != "yaw":
        if result["sign"] > _TOGETHER:
            evidence += f", and to {result['sign']:.2f} with the heading mirrored"
        how = "take another pose, or fix its axes: heading must be anticlockwise with x forward"
        return Finding("warning", channel, "the heading does not follow the course", evidence, how, 1.0)
    line = f"sign = {-drive.rig.channels['yaw'].sign}" if best == "sign" else f'unit = "{best}"'
    evidence += f", and to {result[best]:.2f} with the line below"
    return Finding("fatal", "yaw", "the heading does not follow the course", evidence, f"channels.yaw.{line}", 1.0)


def _moving(path: Path) -> np.ndarray:
    moving: np.ndarray = np.isfinite(path.yaw) & (path.speed > max(0.3, 0.3 * path.cruise))
    return moving


def _resultant(path: Path, factor: float, yaw: Float[np.ndarray, " n"] | None = None) -> float:
    """Length of the mean of exp(i (course - yaw)); backward stretches count as forward."""
    moving = _moving(path)
    if not moving.any():
        return 1.0
    course = np.arctan2(path.velocity[moving, 1], path.velocity[moving, 0])
    turned = course - factor * (path.yaw if yaw is None else yaw)[moving]
    return float(np.sqrt(np.abs(np.mean(np.exp(2j * turned)))))


def _mean_difference(path: Path) -> float:
    """Mean of heading's correction, course minus yaw [rad]."""
    moving = _moving(path)
    course = np.arctan2(path.velocity[moving, 1], path.velocity[moving, 0])
    return float(np.angle(np.mean(np.exp(1j * (course - path.yaw[moving])))))


def _up(quaternion: Float[np.ndarray, "n 4"]) -> float:
    return float(np.median(rotation_from_quaternion(quaternion)[:, 2, 2]))
