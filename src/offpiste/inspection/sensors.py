"""All checks of cameras and LiDARs, in turn."""

from collections.abc import Sequence
from dataclasses import replace

from offpiste.errors import OffpisteError
from offpiste.inspection.camera import check_camera
from offpiste.inspection.findings import Finding
from offpiste.inspection.lidar import check_lidar
from offpiste.inspection.mountings import CheckedSensor, check_mountings
from offpiste.inspection.sensor_samples import Gathered, SmallCamera, gather, small_camera
from offpiste.inspection.sensor_stamps import check_frozen, check_own_body, check_sensor_stamps, refused, untimed_points
from offpiste.logs.log import Log
from offpiste.logs.measurements import Lidar
from offpiste.logs.poses import Poses
from offpiste.logs.sensor_log import open_sensors
from offpiste.progress import track
from offpiste.rig.rig import Rig
from offpiste.rig.sensors import CameraSource, LidarSource


def check_sensors(log: Log, rig: Rig) -> list[Finding]:
    """Findings on the cameras and LiDARs that a rig names; none where it names none.

    Reads all stamps, and the images and scans of the first minute of driving. What makes a log unfit for visual
    features is a warning: it can still be trained on without them.
    """
    named: tuple[CameraSource | LidarSource, ...] = (*rig.cameras.values(), *rig.lidars.values())
    if all(source.optional and source.topic not in log.topics for source in named):
        return []
    try:
        sensors = open_sensors(log, rig)
        findings = check_sensor_stamps(log, sensors)
        cameras = {name: small_camera(camera) for name, camera in sensors.cameras.items()}
        gathered = gather(sensors, cameras)
    except OffpisteError as error:
        return [refused(error, "cameras and LiDARs")]
    for name, lidar in sensors.lidars.items():
        findings += check_own_body(lidar, gathered.scans[name], rig.vehicle.wheel_positions)
    for name in cameras:
        findings += check_frozen(name, gathered.images[name])
    if sensors.notes:
        evidence = "; ".join(sensors.notes)
        findings.append(
            Finding("note", "cameras and LiDARs", "are there in part", evidence, "nothing where the rest is enough")
        )
    untimed = untimed_points(log, sensors.lidars)
    checked = [
        replace(one, untimed=untimed.get(one.sensor.name, ""))
        for one in lidar_misfits(sensors.lidars, gathered, sensors.poses)
    ]
    return findings + check_mountings(checked + camera_misfits(cameras, checked, gathered, sensors.poses))


def lidar_misfits(lidars: dict[str, Lidar], gathered: Gathered, poses: Poses) -> list[CheckedSensor]:
    """Check the LiDARs against the poses."""
    named = track(lidars.items(), "LiDARs", total=len(lidars))
    return [CheckedSensor(lidar, check_lidar(lidar, gathered.scans[name], poses)) for name, lidar in named]


def camera_misfits(
    cameras: dict[str, SmallCamera], lidars: Sequence[CheckedSensor], gathered: Gathered, poses: Poses
) -> list[CheckedSensor]:
    """Check the cameras against the poses; distances come from the LiDAR with most scans, corrected if it is off.

    Args:
        lidars: with their own misfits.
    """
    rulers = {one.sensor.name: one for one in lidars if isinstance(one.sensor, Lidar)}
    if not rulers:
        return [CheckedSensor(camera.camera, None) for camera in cameras.values()]
    ruler = rulers[max(rulers, key=lambda name: len(gathered.scans[name]))]
    lidar, scans = ruler.sensor, gathered.scans[ruler.sensor.name]
    assert isinstance(lidar, Lidar), "rulers are LiDARs"
    known = ruler.misfit.parameters if ruler.misfit and (ruler.is_turned or ruler.is_late) else None
    found = []
    for name, camera in track(cameras.items(), "cameras", total=len(cameras)):
        misfit = check_camera(camera, gathered.images[name], lidar, scans, poses, known)
        found.append(CheckedSensor(camera.camera, misfit))
    return found
