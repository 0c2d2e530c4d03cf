"""Checks of the stamps, mountings and delays of cameras and LiDARs.

A finding has a fix if the fit allows no other cause. Unlike fixes of channels, it is not tested by another inspection,
since the fit already compared the measurements at the corrected mounting and delay.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import islice, pairwise
from typing import Any, Final

import msgspec
import numpy as np
from jaxtyping import Float

from offpiste.calibration.camera import check_camera
from offpiste.calibration.lidar import WORLD, check_lidar
from offpiste.calibration.map_health import MapHealth, map_health
from offpiste.calibration.misfit import LEAST_PAIRS, Misfit, turned
from offpiste.calibration.mountings import AXES, mounting_entry, unknown
from offpiste.calibration.own_body import AROUND, find_own_body
from offpiste.calibration.samples import Gathered, Grey, SmallCamera, gather, small_camera
from offpiste.core.errors import OffpisteError
from offpiste.core.progress import track
from offpiste.inspection.clocks import APART, DRIFT, ORIGINS
from offpiste.inspection.findings import MESSAGES, Cure, Finding, Severity, found, unreadable
from offpiste.inspection.recorded_log import Recorded, without_values
from offpiste.inspection.stamps import check_spans, check_stamps
from offpiste.logs.clock_drift import clock_difference
from offpiste.logs.log import Log
from offpiste.logs.measurements import Camera, Lidar, lines, misread_times, proposed_times
from offpiste.logs.poses import Poses
from offpiste.logs.sensor_log import SensorLog, open_sensors
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
MANY_GHOSTS: Final = 1e-4
"""Minimum reported share of returns below the ground: ten in a scan of 100,000. Simulated drives: below 3e-5."""
MUCH_DRIFT: Final = 0.05
"""Height drift for a warning [m/s]: one voxel of 0.2 m within the 4 s that a cell is in view before the wheels reach
it, which turns level ground into an obstacle."""
SOME_DRIFT: Final = 0.02
"""Height drift for a note [m/s]. Simulated drives: 0.002; KITTI's GPS: 0.05."""
MUCH_MOVING: Final = 0.004
"""Minimum reported share of moving returns. Simulated drives: up to 0.0012; with 1 % of dust: 0.006."""
_FROZEN: Final = 0.1
"""Minimum reported share of images that repeat the one before."""
_POSE: Final = ("position", "orientation", "yaw")
_TURNS_OF_POSE: Final = {"channels.orientation.offset"}
_DELAYS_OF_POSE: Final = {f"channels.{name}.delay" for name in _POSE}
_PAUSE: Final = 1.0
"""Minimum gap of a sensor [s]; images are infrequent and not interpolated."""
_STAMPS: Final = 50
"""Minimum number of messages for detecting a drift."""
_SCANS: Final = 5
"""Number of scans whose point times are checked."""
_HALF: Final = 0.5
"""Maximum share of the drive without a sensor for a note instead of a warning."""
_OF_CHANNELS: Final = {"clock.unit", "clock.max_gap"}
"""Entries that state the unit and longest gap of channels, not of images."""


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
    def kind(self) -> str:
        """Kind of the sensor: "camera" or "lidar"."""
        return "camera" if isinstance(self.sensor, Camera) else "lidar"

    @property
    def key(self) -> str:
        """Name of the sensor's table in the rig."""
        return f"{self.kind}s.{self.sensor.name}"

    @property
    def mounting(self) -> Float[np.ndarray, "4 4"]:
        """Mounting `body_from_sensor` as in the rig."""
        return self.sensor.body_from_camera if isinstance(self.sensor, Camera) else self.sensor.body_from_lidar

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
        misfit = one.misfit
        if misfit is None:
            result.append(found("unseen", one.sensor.name, {"why": MESSAGES["sensors"][one.kind]["unseen"]}))
            continue
        basis = {"pairs": misfit.pairs, "measurements": MESSAGES["sensors"][one.kind]["measurements"]}
        if isinstance(one.sensor, Lidar) and misfit.scale > WORLD:
            result.append(found("no_common_world", one.sensor.name, {**basis, "scale": misfit.scale, "key": one.key}))
            continue
        if one.is_turned:
            alike = _alike([other for other in checked if other.is_turned], slice(0, 3), TURN, len(checked))
            result.append(_turned(one, misfit, basis, "alike" if alike else "cured" if cured & _TURNS_OF_POSE else ""))
        if one.is_late:
            alike = _alike([other for other in checked if other.is_late], slice(3, 4), LATE, len(checked))
            result.append(_late(one, misfit, basis, "alike" if alike else "cured" if cured & _DELAYS_OF_POSE else ""))
        vague = unknown(misfit.sigma, KNOWN_TURN)
        vague += [f"delay (± {misfit.sigma[3] * 1e3:.0f} ms)"] if not misfit.sigma[3] < KNOWN_LATE else []
        if vague:
            result.append(found("checked_in_part", one.sensor.name, {"vague": ", ".join(vague)}))
    return result


def _turned(one: CheckedSensor, misfit: Misfit, basis: dict[str, Any], blamed: str) -> Finding:
    """Return the finding on a rotated sensor.

    Args:
        basis: what the misfit was estimated from.
        blamed: why the pose may be turned instead: "alike" or "cured"; "" if nothing suggests it.
    """
    sensor, known = one.sensor, misfit.sigma[:3] < KNOWN_TURN
    # Unknown angles keep the values of the rig.
    matrix = turned(one.mounting, np.where(np.append(known, True), misfit.parameters, 0.0))
    fix = Edit(f"{one.key}.body_from_{one.kind}", mounting_entry(matrix, 4))
    rectified = isinstance(sensor, Camera) and sensor.source.rectified
    angle, sigma = one.turn
    parts = zip(AXES, np.rad2deg(misfit.parameters), np.rad2deg(misfit.sigma), known, strict=False)
    axes = ", ".join(
        f"{axis} {turn:+.2f} (standard deviation {error:.2f})" for axis, turn, error, sure in parts if sure
    )
    values = {**basis, "angle": np.rad2deg(angle), "axes": axes, "cure": fix}
    cure = () if blamed or rectified else (fix,)
    score = float(min(1.0, (angle - sigma) / np.deg2rad(5)))
    return found("turned", sensor.name, values, cure, score=score, remedy=blamed or "rectified")


def _late(one: CheckedSensor, misfit: Misfit, basis: dict[str, Any], blamed: str) -> Finding:
    """Return the finding on a delayed sensor (arguments as for `_turned`)."""
    late, sigma = 1e3 * float(misfit.parameters[3]), 1e3 * float(misfit.sigma[3])
    fix = Edit(f"{one.key}.delay", round(one.sensor.source.delay + late / 1e3, 3))
    values = {**basis, "late": late, "size": abs(late), "side": "late" if late > 0 else "early", "sigma": sigma}
    values |= {"cure": fix, "untimed": one.untimed}
    cure, remedy = () if one.untimed or blamed else (fix,), "untimed" if one.untimed else blamed
    return found("late", one.sensor.name, values, cure, score=min(1.0, abs(late) / 200), remedy=remedy)


def _alike(checked: Sequence[CheckedSensor], part: slice, floor: float, of: int) -> bool:
    """Return whether these are all sensors of the log, at least two, with consistent misfits."""
    misfits = [one.misfit for one in checked if one.misfit is not None]
    if len(misfits) < 2 or len(misfits) < of:
        return False
    parameters, sigma = (np.array([getattr(m, each)[part] for m in misfits]) for each in ("parameters", "sigma"))
    apart, sure = np.abs(parameters - parameters[0]), SURE * np.hypot(sigma, sigma[0])
    return bool((apart[1:] < sure[1:] + floor).all())


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
        when = f"on reading it{f': {error.where}' if error.where else ''}"
        return [unreadable("cameras and LiDARs", error, when, severity="warning")]
    for lidar in sensors.lidars.values():
        findings += check_own_body(lidar, gathered, sensors.poses, rig.vehicle.wheel_positions)
    for name in cameras:
        findings += check_repeated_images(name, gathered.images[name])
    if sensors.notes:
        findings.append(found("sensors_in_part", "cameras and LiDARs", {"notes": "; ".join(sensors.notes)}))
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
    own = find_own_body(lidar, gathered.scans[lidar.name], poses, wheels)
    if own is None:
        return []
    cure = Edit(f"lidars.{lidar.name}.own_body", own.box.round(2).tolist())
    return [found("own_body", lidar.name, {"returns": own.returns, "around": AROUND, "scans": own.scans}, (cure,))]


def check_repeated_images(name: str, images: Sequence[Grey]) -> list[Finding]:
    """Return a finding if consecutive images are identical."""
    same = [np.array_equal(a.pixels, b.pixels) for a, b in pairwise(images)]
    if len(images) < 10 or np.mean(same) < _FROZEN:
        return []
    return [found("repeated_images", name, {"same": sum(same), "count": len(same)}, score=float(np.mean(same)))]


def check_sensor_stamps(log: Log, sensors: SensorLog) -> list[Finding]:
    """Check gaps, losses, repeats, backward steps, spans and clocks of all cameras and LiDARs from all stamps.

    No finding is fatal, as training works without sensors, and none has an automatic fix: the rig's clock settings
    apply to all topics, and sensors are not read again to test a fix.
    """
    rig, place = sensors.rig, sensors.rig.channels["position"]
    sources: dict[str, CameraSource | LidarSource] = {f"cameras.{n}": c.source for n, c in sensors.cameras.items()}
    sources |= {f"lidars.{name}": lidar.source for name, lidar in sensors.lidars.items()}
    pose, *others = (
        without_values(log, source.topic, stamps=rig.clock.stamps, delay=source.delay)
        for source in (place, *sources.values())
    )
    recorded = {topic.topic.name: topic for topic in others}
    several = {name: topic for name, topic in recorded.items() if len(topic.time) > 2}
    clock = msgspec.structs.replace(rig.clock, max_gap=max(_PAUSE, rig.clock.max_gap))
    findings = [f for f in check_stamps(several, clock, used=set(several)) if not _OF_CHANNELS & _edited(f)]
    result = [_in_words(finding) for finding in findings]
    unordered = {finding.where for finding in findings if finding.severity == "fatal"}
    named = {source.topic: key for key, source in sources.items() if source.topic not in unordered}
    clocks = [f for topic, key in named.items() for f in _clock(key, sources[key], recorded[topic], pose)]
    apart = unordered | {finding.where for finding in clocks}  # their spans are meaningless
    spans = {place.topic: pose} | {topic: r for topic, r in recorded.items() if topic not in apart}
    for finding in check_spans(spans, place.topic, used=True):
        # Without a sensor, rows lack only visual features, which is acceptable for less than half of the drive.
        severity: Severity = "note" if finding.score < _HALF else "warning"
        remedy = finding.remedy
        if finding.severity == "fatal":
            how = f"{finding.remedy};" if "origins" in finding.what else f"fix {named[finding.where]}.delay,"
            remedy = f"{how} or remove the sensor from the rig"
        result.append(replace(finding, severity=severity, remedy=remedy, cures=()))
    return result + clocks


def _edited(finding: Finding) -> set[str]:
    """Return the entries of the rig that fixes of a finding edit."""
    return {edit.key for cure in finding.cures for edit in cure}


def _in_words(finding: Finding) -> Finding:
    """Return a finding on a sensor's stamp order, with the effect on its messages as remedy instead of a fix."""
    severity: Severity = "note" if finding.severity == "note" else "warning"
    if not finding.cures:
        return replace(finding, severity=severity)
    remedy = MESSAGES["sensors"]["receive" if "clock.stamps" in _edited(finding) else "dropped"]
    return replace(finding, severity=severity, remedy=remedy, cures=())


def untimed_points(sensors: SensorLog) -> dict[str, str]:
    """Return the rig lines that read point times, by LiDAR, for LiDARs without a time field in the rig."""
    result: dict[str, str] = {}
    for name, lidar in sensors.lidars.items():
        first = None if lidar.source.time_field else next(sensors.raw_clouds(name), None)
        entries = {} if first is None else proposed_times(first, sensors.period(name))
        if entries:
            result[name] = lines(name, entries)
    return result


def check_point_times(sensors: SensorLog) -> list[Finding]:
    """Return findings for LiDARs with point times outside a sweep around the scan's stamp.

    A finding has no fix if no unit and origin explain these times.
    """
    result = []
    for name, lidar in sensors.lidars.items():
        first = islice(sensors.raw_clouds(name), _SCANS) if lidar.source.time_field else ()
        read = [misread_times(raw, lidar.source, sensors.period(name)) for raw in first]
        misread = [one for one in read if one is not None]
        if 2 * len(misread) <= len(read):
            continue
        fault, edits = misread[-1], tuple(Edit(f"lidars.{name}.{k}", v) for k, v in misread[-1].entries.items())
        remedy = fault.remedy(name)
        if sensors.rig.clock.stamps == "receive" and "epoch" in fault.entries.values():
            edits, remedy = (), f'{remedy}, with clock.stamps = "header"; or remove lidars.{name}.time_field'
        about = {"what": fault.what, "misread": len(misread), "read": len(read), "remedy": remedy}
        result.append(found("point_times", name, about, edits))
    return result


def _clock(key: str, source: CameraSource | LidarSource, sensor: Recorded, pose: Recorded) -> list[Finding]:
    """Return a finding if a sensor's clock drifts or is offset relative to the pose's clock, by arrival times."""
    if sensor.arrived is None and pose.arrived is None:
        return []
    result = clock_difference(sensor.time, sensor.arrival, pose.time, pose.arrival)
    if result is None or abs(result.offset) > ORIGINS:
        return []
    offset, drift = result
    if abs(drift) > DRIFT and min(len(sensor.time), len(pose.time)) >= _STAMPS:
        return [found("sensor_drifts", sensor.topic.name, {"drift": drift}, score=min(1.0, abs(drift)))]
    if abs(offset) > APART:
        delay = Edit(f"{key}.delay", round(source.delay - offset, 2))
        values = {"apart": abs(offset), "side": "later" if offset > 0 else "earlier", "delay": delay}
        return [found("sensor_apart", sensor.topic.name, values)]
    return []


def check_map_health(health: MapHealth, *, turned: bool = False) -> list[Finding]:
    """Return a warning for height drift, and notes for ghosts and many moving returns.

    Args:
        turned: True if a LiDAR's mounting differs from the rig, which also causes apparent height drift.
    """
    result, least = [], health.drift - SURE * health.drift_error
    values = {**asdict(health), "cm": 100 * health.drift, "cm_error": 100 * health.drift_error}
    if health.drift_pairs >= LEAST_PAIRS and least > SOME_DRIFT:
        severity: Severity = "warning" if least > MUCH_DRIFT and not turned else "note"
        score, remedy = min(1.0, health.drift / 0.2), "turned" if turned else "remedy"
        result.append(found("height_drift", "poses", values, severity=severity, score=score, remedy=remedy))
    if health.ghosts > MANY_GHOSTS:
        result.append(found("ghosts", "LiDARs", values, score=health.ghosts))
    if health.moving_pairs >= LEAST_PAIRS and health.moving > MUCH_MOVING:
        result.append(found("moving", "LiDARs", values, score=health.moving))
    return result
