"""Sensor mountings of a log, estimated from rough guesses: usable rig lines, or reasons of failure."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import LogError
from offpiste.core.progress import track
from offpiste.inspection.camera import check_camera
from offpiste.inspection.camera_mounting import estimate_rotation, matched, median_angle
from offpiste.inspection.camera_place import estimate_place
from offpiste.inspection.draft_sensors import looks
from offpiste.inspection.estimated_mounting import AXES, EstimatedMounting
from offpiste.inspection.lidar import median_distance
from offpiste.inspection.lidar_mounting import LidarMounting, beyond, estimate_lidar, mean_turn
from offpiste.inspection.misfit import PRIOR, Misfit, Parameters, turned
from offpiste.inspection.sensor_samples import Gathered, Grey, Scan, SmallCamera, gather, small_camera
from offpiste.logs.log import Log
from offpiste.logs.measurements import Lidar, body_from_sensor
from offpiste.logs.poses import Poses
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig
from offpiste.rig.sensors import CameraSource, LidarSource

KNOWN: Final = np.deg2rad(1.2)
"""Maximum standard deviation of an estimated roll, pitch or yaw [rad]; the ground alone determines roll to 1 degree."""
PLACE: Final = 0.15
"""Maximum standard deviation of a reported position coordinate [m]."""
_WORLD: Final = 0.2
"""Maximum distance of scans from each other's planes for a consistent world [m]."""
_LINES: Final = np.deg2rad(0.3)
"""Maximum angle of matches from their epipolar lines for a valid rotation [rad]."""
_RIVAL: Final = 1.15
"""Maximum residual ratio at which the second-best heading makes the result ambiguous."""
_REPLACED: Final = np.deg2rad(5.0)
"""Maximum change by the fine fit for its result to be accepted [rad]."""
_STRAIGHT: Final = np.deg2rad(3.0)
"""Maximum rotation in half a second of a straight drive [rad]."""


def estimate_mountings(log: Log, rig: Rig) -> list[EstimatedMounting]:
    """Estimate the mountings of all cameras and LiDARs of a rig.

    Reads the first minute of driving. The guess is the mounting of the rig or the log, otherwise from the sensor's
    name; a LiDAR's heading is ignored and its tilt may be off by 30 degrees, a camera's rotation by 40.

    Raises:
        LogError: the log cannot be read, or has no sensors.
        RigError: the rig has no full poses.
    """
    rig = with_guesses(log, rig)
    sensors = open_sensors(log, rig, rough=True)
    cameras = {name: small_camera(camera) for name, camera in sensors.cameras.items()}
    return estimated(sensors, cameras, gather(sensors, cameras), given_places(log, rig))


def with_guesses(log: Log, rig: Rig) -> Rig:
    """Add guesses by name for sensors whose mounting neither the rig nor the log's transforms state."""
    transforms, edits = log.transforms(rig.frames.topics), []
    entries: dict[str, CameraSource | LidarSource] = {**rig.cameras, **rig.lidars}
    for name, entry in entries.items():
        if entry.topic not in log.topics:
            continue
        try:
            body_from_sensor(log, rig, entry, transforms)
        except LogError:
            edits.append(Edit(_key(name, entry), {"looks": looks(name)}))
    return edited(rig, edits) if edits else rig


def given_places(log: Log, rig: Rig) -> dict[str, tuple[Float[np.ndarray, "4 4"], bool]]:
    """Return `body_from_sensor` of each sensor from the rig or the log, and True if its position is non-zero."""
    transforms = log.transforms(rig.frames.topics)
    result = {}
    entries: dict[str, CameraSource | LidarSource] = {**rig.cameras, **rig.lidars}
    for name, entry in entries.items():
        if entry.topic in log.topics:
            given = entry.mounting
            placed = given is None or given.position is not None
            result[name] = body_from_sensor(log, rig, entry, transforms), placed
    return result


def estimated(
    sensors: SensorLog,
    cameras: dict[str, SmallCamera],
    gathered: Gathered,
    given: dict[str, tuple[Float[np.ndarray, "4 4"], bool]],
) -> list[EstimatedMounting]:
    """Return the estimates from measurements already read; LiDARs come first, as cameras depend on them."""
    near = 1.5 * float(np.linalg.norm(sensors.rig.vehicle.wheel_positions, axis=1).max())
    scans = {name: [beyond(scan, near) for scan in taken] for name, taken in gathered.scans.items()}
    result, rulers = [], []
    for name, lidar in track(sensors.lidars.items(), "LiDARs", total=len(sensors.lidars)):
        one = _lidar(lidar, scans[name], sensors.poses)
        result.append(one)
        if not one.refused:
            rulers.append((replace(lidar, body_from_lidar=one.mounting), scans[name]))
    ruler = max(rulers, key=lambda one: len(one[1]), default=None)
    for name, camera in track(cameras.items(), "cameras", total=len(cameras)):
        result.append(_camera(camera, gathered.images[name], ruler, sensors.poses, *given[name]))
    return result


def _lidar(lidar: Lidar, scans: Sequence[Scan], poses: Poses) -> EstimatedMounting:
    guess = lidar.body_from_lidar
    before = median_distance(lidar, scans, poses)
    nothing = np.full(3, np.nan)
    refused = EstimatedMounting(
        lidar.name, _key(lidar.name, lidar.source), False, guess, guess, nothing, nothing, before, np.nan, "m"
    )
    found = estimate_lidar(lidar, scans, poses)
    if isinstance(found, str):
        return replace(refused, refused=f"{lidar.name}: {found}")
    why = _lidar_refusal(lidar.name, found, mean_turn(poses, scans))
    if why:
        return replace(refused, refused=why)
    mounting, place = found.body_from_lidar.copy(), np.full(3, np.nan)
    known = np.flatnonzero(found.misfit.sigma[4:6] < PLACE)
    place[known] = found.misfit.sigma[4:6][known]
    unknown = [k for k in range(3) if k not in known]
    mounting[unknown, 3] = guess[unknown, 3]
    after = median_distance(replace(lidar, body_from_lidar=mounting), scans, poses)
    return replace(refused, mounting=mounting, sigma=found.misfit.sigma[:3], place_sigma=place, after=after)


def _lidar_refusal(name: str, found: LidarMounting, turn: float) -> str:
    if found.misfit.scale > _WORLD:
        return f"{name}: its scans show no common world with any mounting ({found.misfit.scale:.2f} m apart)"
    if found.runner_up < _RIVAL:
        return f"{name}: another heading fits its scans as well; its surroundings look alike all around"
    return _vague(name, found.misfit.sigma[:3], turn)


def _vague(name: str, sigma: Float[np.ndarray, " 3"], turn: float) -> str:
    axes = [f"{axis} (± {np.rad2deg(s):.1f} degrees)" for axis, s in zip(AXES, sigma, strict=True) if not s < KNOWN]
    why = "the drive is straight" if turn < _STRAIGHT else "too little structure is seen"
    return f"{why}: {' and '.join(axes)} of {name} {'is' if len(axes) == 1 else 'are'} not observable" if axes else ""


def _camera(
    camera: SmallCamera,
    images: Sequence[Grey],
    ruler: tuple[Lidar, Sequence[Scan]] | None,
    poses: Poses,
    given: Float[np.ndarray, "4 4"],
    placed: bool,
) -> EstimatedMounting:
    """Estimate by epipolar geometry, then by image squares and LiDAR points if available.

    Args:
        given: mounting in the rig, of the camera before rectification.
        placed: True if the position is known.
    """
    name, guess = camera.camera.name, camera.camera.body_from_camera
    focal, nothing = float(camera.rectifier.pinhole.matrix[0, 0]), np.full(3, np.nan)
    matches = matched(camera, images)
    before = focal * median_angle(matches, guess, poses)
    key = _key(name, camera.camera.source)
    refused = EstimatedMounting(name, key, True, given, given, nothing, nothing, before, np.nan, "px")
    found = estimate_rotation(guess, matches, poses)
    if isinstance(found, str):
        return replace(refused, refused=f"{name}: {found}")
    mounting, misfit = found
    if misfit.scale > _LINES:
        angle = np.rad2deg(misfit.scale)
        return replace(
            refused, refused=f"{name}: no rotation explains the motion in its images ({angle:.1f} degrees left)"
        )
    place, shift = (
        np.full(3, np.nan),
        None if placed or ruler is None else estimate_place(mounting, matches, *ruler, poses),
    )
    if shift is not None:
        mounting = turned(mounting, np.append(np.zeros(4), shift.parameters[4:]))
    if ruler is not None and (placed or shift is not None):
        mounting, misfit = _fine(camera, images, ruler, poses, mounting, misfit, placed)
        place = misfit.sigma[4:7] if len(misfit.sigma) > 4 else place if shift is None else shift.sigma[4:7]
    why = _vague(name, misfit.sigma[:3], mean_turn(poses, images))
    if why:
        return replace(refused, refused=why)
    after = focal * median_angle(matches, mounting, poses)
    # The unrectified camera rotates and translates about the body axes like the rectified one.
    turn = mounting[:3, :3] @ guess[:3, :3].T
    unrectified = given.copy()
    unrectified[:3, :3] = turn @ given[:3, :3]
    unrectified[:3, 3] = given[:3, 3] + mounting[:3, 3] - guess[:3, 3]
    return replace(refused, mounting=unrectified, sigma=misfit.sigma[:3], place_sigma=place, after=after)


def _fine(
    camera: SmallCamera,
    images: Sequence[Grey],
    ruler: tuple[Lidar, Sequence[Scan]],
    poses: Poses,
    mounting: Float[np.ndarray, "4 4"],
    misfit: Misfit,
    placed: bool,
) -> tuple[Float[np.ndarray, "4 4"], Misfit]:
    """Return the mounting refined by image squares if they are found and agree with the first estimate."""
    moved = replace(camera, camera=replace(camera.camera, body_from_camera=mounting))
    prior: Parameters = PRIOR if placed else np.append(PRIOR, [0.3, 0.3, 0.3])
    fine = check_camera(moved, images, ruler[0], ruler[1], poses, prior=prior)
    if fine is None or np.linalg.norm(fine.parameters[:3]) > _REPLACED or fine.sigma[:3].max() > misfit.sigma[:3].max():
        return mounting, misfit
    return turned(mounting, fine.parameters), fine


def _key(name: str, entry: CameraSource | LidarSource) -> str:
    return f"cameras.{name}.body_from_camera" if isinstance(entry, CameraSource) else f"lidars.{name}.body_from_lidar"
