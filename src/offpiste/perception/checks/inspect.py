"""All checks of cameras and LiDARs, in turn."""

from collections.abc import Sequence
from dataclasses import replace

from offpiste.errors import OffpisteError
from offpiste.logs.checks import Finding
from offpiste.logs.log import Log
from offpiste.logs.measurements import Lidar
from offpiste.logs.poses import Poses
from offpiste.logs.sensors import open_sensors, sensor_source
from offpiste.perception.checks.camera import check_camera
from offpiste.perception.checks.gather import Gathered, SmallCamera, gather, small_camera
from offpiste.perception.checks.lidar import check_lidar
from offpiste.perception.checks.plain import check_frozen, check_own_body, check_sensor_stamps, refused, untimed_points
from offpiste.perception.checks.verdict import Judged, findings_of
from offpiste.progress import track
from offpiste.rig import Rig
from offpiste.rig_sensors import CameraSource, LidarSource


def check_sensors(log: Log, rig: Rig) -> list[Finding]:
    """Findings about the cameras and LiDARs that a rig names; none where it names none.

    Looks at all stamps, and at the images and scans of the first minute of driving. What makes a log unfit for visual
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
        said = "; ".join(sensors.notes)
        findings.append(
            Finding("note", "cameras and LiDARs", "are there in part", said, "nothing where the rest is enough")
        )
    untimed = untimed_points(sensor_source(log, rig), sensors.lidars)
    judged = [
        replace(one, untimed=untimed.get(one.sensor.name, ""))
        for one in judge_lidars(sensors.lidars, gathered, sensors.poses)
    ]
    return findings + findings_of(judged + judge_cameras(cameras, judged, gathered, sensors.poses))


def judge_lidars(lidars: dict[str, Lidar], gathered: Gathered, poses: Poses) -> list[Judged]:
    """LiDARs against the poses."""
    named = track(lidars.items(), "LiDARs", total=len(lidars))
    return [Judged(lidar, check_lidar(lidar, gathered.scans[name], poses)) for name, lidar in named]


def judge_cameras(
    cameras: dict[str, SmallCamera], judged: Sequence[Judged], gathered: Gathered, poses: Poses
) -> list[Judged]:
    """Cameras against the poses; the LiDAR of most scans, set right if it needs that, tells how far things are.

    Args:
        judged: the LiDARs.
    """
    rulers = {one.sensor.name: one for one in judged if isinstance(one.sensor, Lidar)}
    if not rulers:
        return [Judged(camera.camera, None) for camera in cameras.values()]
    ruler = rulers[max(rulers, key=lambda name: len(gathered.scans[name]))]
    lidar, scans = ruler.sensor, gathered.scans[ruler.sensor.name]
    assert isinstance(lidar, Lidar), "rulers are LiDARs"
    known = ruler.misfit.parameters if ruler.misfit and (ruler.is_turned or ruler.is_late) else None
    found = []
    for name, camera in track(cameras.items(), "cameras", total=len(cameras)):
        misfit = check_camera(camera, gathered.images[name], lidar, scans, poses, known)
        found.append(Judged(camera.camera, misfit))
    return found
