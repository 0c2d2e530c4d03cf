"""Checks of the mountings and delays of cameras and LiDARs.

A finding has a fix if the fit allows no other cause. Unlike fixes of channels, it is not tested by another inspection,
since the fit already compared the measurements at the corrected mounting and delay.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Final

import numpy as np

from offpiste.calibration.camera import check_camera
from offpiste.calibration.lidar import check_lidar
from offpiste.calibration.map_health import MapHealth, map_health
from offpiste.calibration.misfit import Misfit, turned
from offpiste.calibration.mountings import AXES, mounting_entry
from offpiste.calibration.own_body import AROUND, find_own_body
from offpiste.calibration.samples import Gathered, Grey, SmallCamera, gather, small_camera
from offpiste.core.errors import OffpisteError
from offpiste.core.progress import track
from offpiste.inspection.findings import Cure, Finding, Severity, fixable
from offpiste.inspection.sensor_stamps import check_point_times, check_sensor_stamps, untimed_points
from offpiste.logs.log import Log
from offpiste.logs.measurements import Camera, Lidar
from offpiste.logs.poses import Poses
from offpiste.logs.sensor_log import open_sensors
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig
from offpiste.rig.sensors import CameraSource, LidarSource

TURN: Final = np.deg2rad(0.5)
"""Maximum mounting error in fault-free drives [rad]; it includes pose errors (KITTI's Velodyne: 0.44 degrees of yaw)
and corresponds to one voxel of 0.2 m at 23 m."""
LATE: Final = 0.010
"""Maximum delay in fault-free drives [s]; 0.1 m at 10 m/s."""
SURE: Final = 3.0
"""Number of standard deviations by which a misfit or a drift in height must exceed its limit."""
KNOWN_TURN: Final = np.deg2rad(0.5)
"""Maximum standard deviation of a known angle [rad]."""
KNOWN_LATE: Final = 0.020
"""Maximum standard deviation of a known delay [s]."""
STARTS: Final = (-0.15, 0.15)
"""Initial delays for refitting a camera that seems rotated [s]: in fast turns, patches searched at a wrong time lie
outside the search area, and a rotation fits the rest."""
APART: Final = 0.2
"""Distance between points and planes of two scans above which they are inconsistent [m]; fault-free: 0.02 to 0.04."""
MANY_GHOSTS: Final = 1e-4
"""Minimum reported share of returns below the ground: ten in a scan of 100,000. Simulated drives: below 3e-5."""
MUCH_DRIFT: Final = 0.05
"""Height drift for a warning [m/s]: one voxel of 0.2 m within the 4 s that a cell is in view before the wheels reach
it, which turns level ground into an obstacle."""
SOME_DRIFT: Final = 0.02
"""Height drift for a note [m/s]. Simulated drives: 0.002; KITTI's GPS: 0.05."""
MUCH_MOVING: Final = 0.004
"""Minimum reported share of moving returns. Simulated drives: up to 0.0012; with 1 % of dust: 0.006."""
LEAST_PAIRS: Final = 8
"""Minimum number of scan pairs for statements about drift and moving returns."""
_FROZEN: Final = 0.1
"""Minimum reported share of images that repeat the one before."""
_POSE: Final = ("position", "orientation", "yaw")
_TURNS_OF_POSE: Final = {"channels.orientation.offset"}
_DELAYS_OF_POSE: Final = {f"channels.{name}.delay" for name in _POSE}
_SAME: Final = "as all sensors say the same"
_CURED: Final = "as the pose is cured above by what the other channels show"
"""Reasons to suspect the pose instead of a sensor."""


@dataclass(frozen=True)
class CheckedSensor:
    """Sensor and its misfit against the poses.

    Attributes:
        misfit: None if it could not be estimated.
        untimed: rig lines that read the point times, if the sensor has them but the rig does not use them.
    """

    sensor: Camera | Lidar
    misfit: Misfit | None
    untimed: str = ""

    @property
    def key(self) -> str:
        """Name of the sensor's table in the rig."""
        return f"{'cameras' if isinstance(self.sensor, Camera) else 'lidars'}.{self.sensor.name}"

    @property
    def turn(self) -> tuple[float, float]:
        """Angle about the known axes and its standard deviation [rad]."""
        if self.misfit is None:
            return 0.0, np.inf
        known = self.misfit.sigma[:3] < KNOWN_TURN
        turn, sigma = self.misfit.parameters[:3][known], self.misfit.sigma[:3][known]
        angle = float(np.linalg.norm(turn))
        return angle, float(np.linalg.norm(turn * sigma) / angle) if angle > 0 else np.inf

    @property
    def is_turned(self) -> bool:
        """Return whether the rotation significantly exceeds that of fault-free drives."""
        angle, sigma = self.turn
        return bool(angle - SURE * sigma > TURN)

    @property
    def is_late(self) -> bool:
        """Return whether the delay significantly exceeds that of fault-free drives, in either direction."""
        if self.misfit is None or not self.misfit.sigma[3] < KNOWN_LATE:
            return False
        return bool(abs(self.misfit.parameters[3]) - SURE * self.misfit.sigma[3] > LATE)


def check_mountings(checked: Sequence[CheckedSensor], cure: Cure = ()) -> list[Finding]:
    """Return warnings for rotated or delayed sensors, and notes on parameters that could not be checked.

    Args:
        cure: fix of the pose used for comparison; sensors are more accurate and show its residual error.
    """
    cured, result = {edit.key for edit in cure}, list[Finding]()
    for one in checked:
        if one.misfit is None:
            result.append(_unseen(one))
            continue
        if isinstance(one.sensor, Lidar) and one.misfit.scale > APART:
            result.append(_apart(one, one.misfit))
            continue
        if one.is_turned:
            alike = _alike([other for other in checked if other.is_turned], slice(0, 3), TURN, len(checked))
            result.append(_turned(one, one.misfit, _SAME if alike else _CURED if cured & _TURNS_OF_POSE else ""))
        if one.is_late:
            alike = _alike([other for other in checked if other.is_late], slice(3, 4), LATE, len(checked))
            result.append(_late(one, one.misfit, _SAME if alike else _CURED if cured & _DELAYS_OF_POSE else ""))
        result += _unknown(one, one.misfit)
    return result


def _turned(one: CheckedSensor, misfit: Misfit, blames_pose: str) -> Finding:
    sensor = one.sensor
    camera = isinstance(sensor, Camera)
    given = sensor.body_from_camera if isinstance(sensor, Camera) else sensor.body_from_lidar
    # Unknown angles keep the values of the rig.
    matrix = turned(given, np.where(np.append(misfit.sigma[:3] < KNOWN_TURN, True), misfit.parameters, 0.0))
    cure = Edit(f"{one.key}.{'body_from_camera' if camera else 'body_from_lidar'}", mounting_entry(matrix, 4))
    remedy, sure = f"calibrate it again; or {cure}", not blames_pose
    if blames_pose:
        remedy += f"; {blames_pose}, the pose's orientation or [frames] body may be what is turned"
    elif isinstance(sensor, Camera) and sensor.source.rectified:
        remedy += " (of the camera before rectification, if its CameraInfo has a rotation R)"
        sure = False
    angle, sigma = one.turn
    what = f"looks {np.rad2deg(angle):.1f} degrees away from where its mounting says"
    evidence = f"{_axes(misfit)}; {_basis(one, misfit)}"
    score = float(min(1.0, (angle - sigma) / np.deg2rad(5)))
    return Finding("warning", sensor.name, what, evidence, remedy, score, ((cure,),) if sure else ())


def _late(one: CheckedSensor, misfit: Misfit, blames_pose: str) -> Finding:
    late, sigma = float(misfit.parameters[3]), float(misfit.sigma[3])
    what = f"is stamped {abs(late) * 1e3:.0f} ms too {'late' if late > 0 else 'early'}, against the poses"
    evidence = f"{late * 1e3:+.1f} ms (standard deviation {sigma * 1e3:.1f}); {_basis(one, misfit)}"
    cure = Edit(f"{one.key}.delay", round(one.sensor.source.delay + late, 3))
    remedy, sure = str(cure), not one.untimed and not blames_pose
    if one.untimed:
        remedy = f"{one.untimed}; only if its scans are compensated: {remedy}"
    elif blames_pose:
        remedy += f"; {blames_pose}, the pose's stamps may be what is off: fix its delay instead"
    return Finding(
        "warning", one.sensor.name, what, evidence, remedy, min(1.0, abs(late) / 0.2), ((cure,),) if sure else ()
    )


def _alike(checked: Sequence[CheckedSensor], part: slice, floor: float, of: int) -> bool:
    """Return whether these are all sensors of the log, at least two, with consistent misfits."""
    misfits = [one.misfit for one in checked if one.misfit is not None]
    if len(misfits) < 2 or len(misfits) < of:
        return False
    first = misfits[0]
    return all(
        (
            np.abs(other.parameters[part] - first.parameters[part])
            < SURE * np.hypot(other.sigma[part], first.sigma[part]) + floor
        ).all()
        for other in misfits[1:]
    )


def _apart(one: CheckedSensor, misfit: Misfit) -> Finding:
    evidence = (
        f"points of one scan lie {misfit.scale:.2f} m from the planes of another (median, scaled), {misfit.pairs} pairs"
    )
    remedy = f"check {one.key}: frame, mounting, time_field, time_unit and delay"
    return Finding("warning", one.sensor.name, "its scans show no common world", evidence, remedy, 1.0)


def _unseen(one: CheckedSensor) -> Finding:
    camera = isinstance(one.sensor, Camera)
    evidence = "squares of ground are not found again in the next image" if camera else "too few scans"
    remedy = "no action needed if it is at a standstill or sees little; else check [frames] body and the mounting, "
    remedy += "which may be far off"
    return Finding("note", one.sensor.name, "could not be checked against the poses", evidence, remedy)


def _unknown(one: CheckedSensor, misfit: Misfit) -> list[Finding]:
    vague = [
        f"{axis} (± {np.rad2deg(sigma):.1f} degrees)"
        for axis, sigma in zip(AXES, misfit.sigma[:3], strict=True)
        if not sigma < KNOWN_TURN
    ]
    vague += [f"delay (± {misfit.sigma[3] * 1e3:.0f} ms)"] if not misfit.sigma[3] < KNOWN_LATE else []
    if not vague:
        return []
    remedy = "no action needed; a drive over rough ground, with turns and changes of speed, would tell"
    return [Finding("note", one.sensor.name, "was checked in part", f"not known: {', '.join(vague)}", remedy)]


def _axes(misfit: Misfit) -> str:
    known = misfit.sigma[:3] < KNOWN_TURN
    parts = [
        f"{axis} {np.rad2deg(turn):+.2f} (standard deviation {np.rad2deg(sigma):.2f})"
        for axis, turn, sigma, sure in zip(AXES, misfit.parameters, misfit.sigma, known, strict=False)
        if sure
    ]
    return "should be turned by " + ", ".join(parts) + " degrees about the body's axes"


def _basis(one: CheckedSensor, misfit: Misfit) -> str:
    return f"{misfit.pairs} pairs of {'images' if isinstance(one.sensor, Camera) else 'scans'}"


def can_be_checked(findings: Sequence[Finding], rig: Rig) -> bool:
    """Return whether the pose, possibly after a fix, is accurate enough to check sensors; controls do not matter."""
    about = {"log", *_POSE, *(rig.channels[name].topic for name in _POSE if name in rig.channels)}
    return not any(f.severity == "fatal" and not f.cures and f.where in about for f in findings)


def check_sensors(log: Log, rig: Rig, cure: Cure = ()) -> list[Finding]:
    """Return findings on the cameras and LiDARs of a rig.

    Reads all stamps, and the images and scans of the first minute of driving. Faults that prevent visual features are
    warnings, as training is still possible without them.

    Args:
        cure: fix of the channels. Sensors are compared with the fixed pose to avoid repeating its faults.
    """
    named: tuple[CameraSource | LidarSource, ...] = (*rig.cameras.values(), *rig.lidars.values())
    if all(source.optional and source.topic not in log.topics for source in named):
        return []
    try:
        sensors = open_sensors(log, edited(rig, cure))
        misread = check_point_times(sensors)
        findings = check_sensor_stamps(log, sensors) + misread
        if not all(finding.cures for finding in misread):
            return findings  # scans are unreadable
        edits = [edit for finding in misread for edit in finding.cures[0]]
        sensors = open_sensors(log, edited(sensors.rig, edits), poses=sensors.poses)
        cameras = {name: small_camera(camera) for name, camera in sensors.cameras.items()}
        gathered = gather(sensors, cameras)
    except OffpisteError as error:
        evidence = f"on reading it{f': {error.where}' if error.where else ''}"
        return [Finding("warning", "cameras and LiDARs", error.what, evidence, error.how, 1.0)]
    for lidar in sensors.lidars.values():
        findings += check_own_body(lidar, gathered, sensors.poses, rig.vehicle.wheel_positions)
    for name in cameras:
        findings += check_repeated_images(name, gathered.images[name])
    if sensors.notes:
        evidence = "; ".join(sensors.notes)
        findings.append(
            Finding("note", "cameras and LiDARs", "are read in part", evidence, "no action needed if enough remains")
        )
    untimed = untimed_points(sensors)
    checked = [
        replace(one, untimed=untimed.get(one.sensor.name, ""))
        for one in lidar_misfits(sensors.lidars, gathered, sensors.poses)
    ]
    health, misplaced = map_health(sensors.lidars, gathered, sensors.poses), any(one.is_turned for one in checked)
    findings += check_map_health(health, turned=misplaced)
    return findings + check_mountings(checked + camera_misfits(cameras, checked, gathered, sensors.poses), cure)


def lidar_misfits(lidars: dict[str, Lidar], gathered: Gathered, poses: Poses) -> list[CheckedSensor]:
    """Check the LiDARs against the poses."""
    named = track(lidars.items(), "LiDARs", total=len(lidars))
    return [CheckedSensor(lidar, check_lidar(lidar, gathered.scans[name], poses)) for name, lidar in named]


def camera_misfits(
    cameras: dict[str, SmallCamera], lidars: Sequence[CheckedSensor], gathered: Gathered, poses: Poses
) -> list[CheckedSensor]:
    """Check the cameras against the poses, by surfaces that the LiDAR with most scans sees, corrected if necessary.

    Args:
        lidars: LiDARs with their misfits.
    """
    rulers = [(len(gathered.scans[one.sensor.name]), one) for one in lidars]
    if not rulers:
        return [CheckedSensor(camera.camera, None) for camera in cameras.values()]
    _, ruler = max(rulers, key=lambda one: one[0])
    lidar, scans = ruler.sensor, gathered.scans[ruler.sensor.name]
    assert isinstance(lidar, Lidar), "rulers are LiDARs"
    known = ruler.misfit.parameters if ruler.misfit and (ruler.is_turned or ruler.is_late) else None
    result = []
    for name, camera in track(cameras.items(), "cameras", total=len(cameras)):
        check = partial(check_camera, camera, gathered.images[name], lidar, scans, poses, known)
        one = CheckedSensor(camera.camera, check())
        if one.misfit is not None and one.is_turned:
            one = replace(one, misfit=_best([one.misfit, *(check(start=np.array([0, 0, 0, late])) for late in STARTS)]))
        result.append(one)
    return result


def _best(misfits: Sequence[Misfit | None]) -> Misfit:
    """Return the fit with the smallest residuals among those with almost the maximum number of residuals."""
    known = [misfit for misfit in misfits if misfit is not None]
    most = max(misfit.residuals for misfit in known)
    return min((misfit for misfit in known if misfit.residuals >= 0.9 * most), key=lambda misfit: misfit.scale)


def check_own_body(
    lidar: Lidar, gathered: Gathered, poses: Poses, wheels: Sequence[tuple[float, float]]
) -> list[Finding]:
    """Return a finding if a LiDAR sees the vehicle itself, with the box that hides it.

    Args:
        wheels: x, y in the body frame [m].
    """
    found = find_own_body(lidar, gathered.scans[lidar.name], poses, wheels)
    if found is None:
        return []
    evidence = f"{found.returns:.0f} returns a scan stay at the same places of the body frame, above the ground and "
    evidence += f"within {AROUND:g} m of the wheels, in {found.scans} scans on the way"
    cure = Edit(f"lidars.{lidar.name}.own_body", found.box.round(2).tolist())
    return [fixable("warning", lidar.name, "sees the vehicle itself", evidence, (cure,))]


def check_repeated_images(name: str, images: Sequence[Grey]) -> list[Finding]:
    """Return a finding if consecutive images are identical."""
    same = [np.array_equal(a.pixels, b.pixels) for a, b in pairwise(images)]
    if len(images) < 10 or np.mean(same) < _FROZEN:
        return []
    evidence = f"{sum(same)} of {len(same)} images are identical to the previous one, bit for bit"
    how = "record it again: its driver hangs"
    return [Finding("warning", name, "repeats images", evidence, how, float(np.mean(same)))]


def check_map_health(health: MapHealth, *, turned: bool = False) -> list[Finding]:
    """Return a warning for height drift, and notes for ghosts and many moving returns.

    Args:
        turned: True if a LiDAR's mounting differs from the rig, which also causes apparent height drift.
    """
    result = []
    least = health.drift - SURE * health.drift_error
    if health.drift_pairs >= LEAST_PAIRS and least > SOME_DRIFT:
        evidence = (
            f"the same ground is {100 * health.drift:.1f} cm higher or lower after 1 s (standard error "
            f"{100 * health.drift_error:.1f}); {health.drift_pairs} pairs of scans 1.5 to 4 s apart"
        )
        remedy = "take poses from a source with a better height (LiDAR odometry, RTK); no rig line helps"
        if turned:
            remedy = "correct the mounting of the LiDAR that is turned, which can do this, and inspect again"
        severity: Severity = "warning" if least > MUCH_DRIFT and not turned else "note"
        result.append(Finding(severity, "poses", "drift in height", evidence, remedy, min(1.0, health.drift / 0.2)))
    if health.ghosts > MANY_GHOSTS:
        evidence = (
            f"{health.ghosts:.3%} of {health.returns} returns within 25 m, from rays that pass below ground nearer by"
        )
        remedy = "no action needed: the map leaves them out (mapping.ghosts); other software may not"
        result.append(Finding("note", "LiDARs", "see ghosts below the ground", evidence, remedy, health.ghosts))
    if health.moving_pairs >= LEAST_PAIRS and health.moving > MUCH_MOVING:
        evidence = (
            f"{health.moving:.1%} of the returns within 30 m, where rays passed through half a second earlier;"
            f" {health.moving_pairs} pairs of scans"
        )
        remedy = "no action needed: near the vehicle, their trails leave the map (mapping.free_space)"
        result.append(Finding("note", "LiDARs", "see much that moves", evidence, remedy, health.moving))
    return result
