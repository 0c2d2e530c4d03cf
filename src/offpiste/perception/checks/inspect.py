"""All checks of cameras and LiDARs, in turn."""

from offpiste.errors import OffpisteError
from offpiste.logs.checks import Finding
from offpiste.logs.log import Log
from offpiste.logs.sensors import SensorLog, open_sensors
from offpiste.perception.checks.camera import check_camera
from offpiste.perception.checks.gather import Gathered, SmallCamera, gather, small_camera
from offpiste.perception.checks.lidar import check_lidar
from offpiste.perception.checks.plain import check_frozen, check_own_body, check_sensor_stamps, refused
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
    return findings + findings_of(judge(sensors, cameras, gathered))


def judge(sensors: SensorLog, cameras: dict[str, SmallCamera], gathered: Gathered) -> list[Judged]:
    """LiDARs against the poses, then cameras, with the LiDAR of most scans, set right if needed, as ruler."""
    judged = []
    for name, lidar in track(sensors.lidars.items(), "LiDARs", total=len(sensors.lidars)):
        judged.append(Judged(lidar, check_lidar(lidar, gathered.scans[name], sensors.poses)))
    if not judged:
        return [Judged(camera, None) for camera in sensors.cameras.values()]
    ruler = max(judged, key=lambda one: len(gathered.scans[one.sensor.name]))
    known = ruler.misfit.parameters if ruler.misfit and (ruler.is_turned or ruler.is_late) else None
    lidar, scans = sensors.lidars[ruler.sensor.name], gathered.scans[ruler.sensor.name]
    for name, camera in track(cameras.items(), "cameras", total=len(cameras)):
        found = check_camera(camera, gathered.images[name], lidar, scans, sensors.poses, known)
        judged.append(Judged(sensors.cameras[name], found))
    return judged
