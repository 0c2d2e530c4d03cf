"""Sensor mountings of a log, estimated from rough guesses: usable rig lines, or reasons of failure."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from rich.console import RenderableType
from rich.text import Text
from scipy.spatial.transform import Rotation

from offpiste.calibration.camera import check_camera
from offpiste.calibration.camera_place import estimate_place
from offpiste.calibration.image_motion import estimate_rotation, matched, median_angle
from offpiste.calibration.lidar import estimate_lidar, mean_turn, median_distance
from offpiste.calibration.misfit import PRIOR, Misfit, Parameters, turned
from offpiste.calibration.samples import Gathered, Grey, Scan, SmallCamera, gather, small_camera
from offpiste.core.errors import LogError
from offpiste.core.progress import track
from offpiste.logs.log import Log
from offpiste.logs.measurements import Lidar, body_from_sensor
from offpiste.logs.poses import Poses
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.rig.edits import Edit, edited
from offpiste.rig.labels import looks
from offpiste.rig.rig import Rig
from offpiste.rig.sensors import OPTICAL, CameraSource, LidarSource

AXES: Final = ("roll", "pitch", "yaw")
KNOWN: Final = np.deg2rad(1.2)
"""Maximum standard deviation of an estimated roll, pitch or yaw [rad]; the ground alone determines roll to 1 degree."""
PLACE: Final = 0.15
"""Maximum standard deviation of a reported position coordinate [m]."""
_LINES: Final = np.deg2rad(0.3)
"""Maximum angle of matches from their epipolar lines, or from surfaces, for a valid rotation [rad]."""
_REPLACED: Final = np.deg2rad(5.0)
"""Maximum change by the fit to surfaces for its result to be accepted [rad]."""
_STRAIGHT: Final = np.deg2rad(3.0)
"""Maximum rotation in half a second of a straight drive [rad]."""


@dataclass(frozen=True)
class EstimatedMounting:
    """A sensor's mounting before and after estimation, or the reason of failure.

    Attributes:
        name: of the sensor in the rig.
        key: of the rig's entry, e.g. "lidars.top.body_from_lidar".
        optical: True for a camera, with axes z forward, x right, y down.
        guess, mounting: `body_from_sensor`; identical if the estimate failed.
        before, after: residual of the guess and of the estimate, in `unit`; NaN without comparable data.
        unit: "m" for LiDARs (median distance from another scan's planes), "px" for cameras (from epipolar lines).
        refused: reason of failure; "" if there is an estimate.
        sigma: standard deviations of the rotation about the body's x, y and z [rad]; NaN without an estimate.
        place_sigma: standard deviations of the position [m]; NaN for coordinates taken from the guess.
    """

    name: str
    key: str
    optical: bool
    guess: Float[np.ndarray, "4 4"]
    mounting: Float[np.ndarray, "4 4"]
    before: float
    after: float = np.nan
    unit: str = "m"
    refused: str = ""
    sigma: tuple[float, ...] = (np.nan,) * 3
    place_sigma: tuple[float, ...] = (np.nan,) * 3

    @property
    def roll_pitch_yaw(self) -> Float[np.ndarray, " 3"]:
        """Return the mounting's angles [rad]; for cameras, with axes x forward, y left, z up."""
        matrix = self.mounting[:3, :3] @ OPTICAL.T if self.optical else self.mounting[:3, :3]
        return np.asarray(Rotation.from_matrix(matrix).as_euler("ZYX")[::-1])

    @property
    def edit(self) -> Edit | None:
        """Return the rig line; None without an estimate."""
        return None if self.refused else Edit(self.key, mounting_entry(self.mounting, 3))

    def as_dict(self) -> dict[str, Any]:
        """Return plain numbers and strings for JSON, in degrees; unknown numbers are null."""
        edit = self.edit
        return {
            "sensor": self.name,
            "refused": self.refused,
            "roll_pitch_yaw_deg": np.rad2deg(self.roll_pitch_yaw).tolist() if edit else None,
            "sigma_deg": [_plain(float(np.rad2deg(sigma))) for sigma in self.sigma],
            "position": self.mounting[:3, 3].tolist() if edit else None,
            "position_sigma": [_plain(sigma) for sigma in self.place_sigma],
            "residual_before": _plain(self.before),
            "residual_after": _plain(self.after),
            "residual_unit": self.unit,
            "key": self.key,
            "value": edit.value if edit else None,
            "line": str(edit) if edit else "",
        }

    def __rich__(self) -> Text:
        """Return the result with its uncertainties and the rig line as text."""
        edit = self.edit
        what, seen = "its mounting could not be estimated", self.refused
        if edit is not None:
            turn = Rotation.from_matrix(self.guess[:3, :3].T @ self.mounting[:3, :3]).magnitude()
            what = f"its mounting is estimated, {np.rad2deg(turn):.1f} degrees from the guess"
            degrees = np.rad2deg(self.roll_pitch_yaw), np.rad2deg(self.sigma)
            angles = [f"{axis} {value:.2f} ± {sigma:.2f}" for axis, value, sigma in zip(AXES, *degrees, strict=True)]
            sigmas = [f"± {sigma:.2f}" if np.isfinite(sigma) else "(the guess's)" for sigma in self.place_sigma]
            place = [f"{a} {v:.2f} {s}" for a, v, s in zip("xyz", self.mounting[:3, 3], sigmas, strict=True)]
            compared = {"m": "points lie off the planes of another scan", "px": "features lie off their epipolar lines"}
            seen = f"{', '.join(angles)} degrees; {', '.join(place)} m; {compared[self.unit]} by {self.after:.3g} "
            seen += f"{self.unit} (median), {self.before:.3g} before"
        text = Text(f"{self.name}: {what}\n", style="bold" if edit else "yellow")
        text.append(f"   seen: {seen}\n   fix: ", style="not bold default")
        return text.append(str(edit or "nothing; drive turns and over rough ground, or give it by hand"), style="cyan")


def mounting_entry(matrix: Float[np.ndarray, "4 4"], digits: int) -> dict[str, list[float]]:
    """Return a mounting as an entry of a rig, with a number of decimals of the position [m]."""
    place, orientation = matrix[:3, 3].round(digits), Rotation.from_matrix(matrix[:3, :3]).as_quat().round(6)
    return {"position": (place + 0.0).tolist(), "orientation": (orientation + 0.0).tolist()}


def _plain(value: float) -> float | None:
    return value if np.isfinite(value) else None


def estimate_mountings(log: Log, rig: Rig) -> list[EstimatedMounting]:
    """Estimate the mountings of all cameras and LiDARs of a rig.

    Reads the first minute of driving. The guess is the mounting of the rig or the log, otherwise from the sensor's
    name; a LiDAR's heading is ignored and its tilt may be off by 30 degrees, a camera's rotation by 40. LiDARs come
    first, as cameras depend on them.

    Raises:
        LogError: the log cannot be read, or has no sensors.
        RigError: the rig has no full poses.
    """
    transforms, guesses = log.transforms(rig.frames.topics), []
    entries: dict[str, CameraSource | LidarSource] = {**rig.cameras, **rig.lidars}
    for name, entry in entries.items():
        if entry.topic in log.topics:
            try:
                body_from_sensor(log, rig, entry, transforms)
            except LogError:  # neither the rig nor the transforms state it
                guesses.append(Edit(_key(name, entry), {"looks": looks(name)}))
    sensors = open_sensors(log, edited(rig, guesses), rough=True)
    cameras = {name: small_camera(camera) for name, camera in sensors.cameras.items()}
    given = {}
    for name, camera in sensors.cameras.items():
        stated = camera.source.mounting
        placed = stated is None or stated.position is not None
        given[name] = body_from_sensor(log, sensors.rig, camera.source, transforms), placed
    return estimated(sensors, cameras, gather(sensors, cameras), given)


def _key(name: str, entry: CameraSource | LidarSource) -> str:
    return f"cameras.{name}.body_from_camera" if isinstance(entry, CameraSource) else f"lidars.{name}.body_from_lidar"


def estimated(
    sensors: SensorLog,
    cameras: dict[str, SmallCamera],
    gathered: Gathered,
    given: dict[str, tuple[Float[np.ndarray, "4 4"], bool]],
) -> list[EstimatedMounting]:
    """Return the estimates from measurements already read.

    Args:
        given: by camera, its mounting before rectification, and True if its position is known.
    """
    near = 1.5 * float(np.linalg.norm(sensors.rig.vehicle.wheel_positions, axis=1).max())
    scans = {
        name: [scan.kept(np.linalg.norm(scan.points, axis=1) > near) for scan in taken]  # without the vehicle itself
        for name, taken in gathered.scans.items()
    }
    result, rulers = [], []
    for name, lidar in track(sensors.lidars.items(), "LiDARs", total=len(sensors.lidars)):
        result.append(_lidar(lidar, scans[name], sensors.poses))
        if not result[-1].refused:
            rulers.append((replace(lidar, body_from_lidar=result[-1].mounting), scans[name]))
    ruler = max(rulers, key=lambda one: len(one[1]), default=None)
    for name, camera in track(cameras.items(), "cameras", total=len(cameras)):
        result.append(_camera(camera, gathered.images[name], ruler, sensors.poses, *given[name]))
    return result


def _lidar(lidar: Lidar, scans: Sequence[Scan], poses: Poses) -> EstimatedMounting:
    name, guess = lidar.name, lidar.body_from_lidar
    before = median_distance(lidar, scans, poses)
    failed = EstimatedMounting(name, _key(name, lidar.source), False, guess, guess, before)
    found = estimate_lidar(lidar, scans, poses)
    if isinstance(found, str):
        return replace(failed, refused=f"{name}: {found}")
    estimate, sigma = found[0], found[1].sigma
    if why := _vague(name, sigma[:3], mean_turn(poses, scans)):
        return replace(failed, refused=why)
    place = np.full(3, np.nan)
    place[: len(sigma[4:6])] = np.where(sigma[4:6] < PLACE, sigma[4:6], np.nan)
    mounting = estimate.copy()
    mounting[:3, 3] = np.where(np.isfinite(place), estimate[:3, 3], guess[:3, 3])
    after = median_distance(replace(lidar, body_from_lidar=mounting), scans, poses)
    return replace(failed, mounting=mounting, sigma=tuple(sigma[:3]), place_sigma=tuple(place), after=after)


def _vague(name: str, sigma: Float[np.ndarray, " 3"], turn: float) -> str:
    """Return why the drive leaves angles of a sensor unknown; "" if it determines all."""
    why, axes = "the drive is straight" if turn < _STRAIGHT else "too little structure is seen", unknown(sigma, KNOWN)
    return f"{why}: {' and '.join(axes)} of {name} {'is' if len(axes) == 1 else 'are'} not observable" if axes else ""


def unknown(sigma: Float[np.ndarray, " k"], limit: float) -> list[str]:
    """Return the axes whose angles have standard deviations above a limit [rad], in words."""
    return [f"{axis} (± {np.rad2deg(s):.1f} degrees)" for axis, s in zip(AXES, sigma, strict=False) if not s < limit]


def _camera(
    camera: SmallCamera,
    images: Sequence[Grey],
    ruler: tuple[Lidar, Sequence[Scan]] | None,
    poses: Poses,
    given: Float[np.ndarray, "4 4"],
    placed: bool,
) -> EstimatedMounting:
    """Estimate by epipolar geometry, then by image squares on surfaces that a LiDAR sees if there is one.

    Args:
        given: mounting in the rig, of the camera before rectification.
        placed: True if the position is known.
    """
    name, guess = camera.camera.name, camera.camera.body_from_camera
    focal, matches = float(camera.rectifier.pinhole.matrix[0, 0]), matched(camera, images)
    before, key = focal * median_angle(matches, guess, poses), _key(name, camera.camera.source)
    failed = EstimatedMounting(name, key, True, given, given, before, unit="px")
    found = estimate_rotation(guess, matches, poses)
    if isinstance(found, str):
        return replace(failed, refused=f"{name}: {found}")
    mounting, misfit = found
    place = None if placed or ruler is None else estimate_place(mounting, matches, *ruler, poses)
    if place is not None:
        mounting = turned(mounting, np.append(np.zeros(4), place.parameters[4:]))
    if ruler is not None and (placed or place is not None):
        mounting, misfit = _fine(camera, images, ruler, poses, mounting, misfit, placed=placed)
    if misfit.scale > _LINES:
        angle = np.rad2deg(misfit.scale)
        why = f"no rotation explains the motion in its images ({angle:.1f} degrees left)"
        return replace(failed, refused=f"{name}: {why}")
    if why := _vague(name, misfit.sigma[:3], mean_turn(poses, images)):
        return replace(failed, refused=why)
    after = focal * median_angle(matches, mounting, poses)
    # The unrectified camera rotates and translates about the body axes like the rectified one.
    unrectified = given.copy()
    unrectified[:3, :3] = mounting[:3, :3] @ guess[:3, :3].T @ given[:3, :3]
    place_sigma = np.full(3, np.nan)
    if place is not None:
        sigma_of_place = (misfit if len(misfit.sigma) > 4 else place).sigma[4:7]
        place_sigma = np.where(sigma_of_place < PLACE, sigma_of_place, np.nan)
        shown = np.isfinite(place_sigma)
        unrectified[:3, 3] += np.where(shown, mounting[:3, 3] - guess[:3, 3], 0.0)
    sigma = tuple(misfit.sigma[:3])
    return replace(failed, mounting=unrectified, sigma=sigma, place_sigma=tuple(place_sigma), after=after)


def _fine(
    camera: SmallCamera,
    images: Sequence[Grey],
    ruler: tuple[Lidar, Sequence[Scan]],
    poses: Poses,
    mounting: Float[np.ndarray, "4 4"],
    misfit: Misfit,
    *,
    placed: bool,
) -> tuple[Float[np.ndarray, "4 4"], Misfit]:
    """Return the mounting refined by image squares if they are found and agree with the first estimate."""
    moved = replace(camera, camera=replace(camera.camera, body_from_camera=mounting))
    prior: Parameters = PRIOR if placed else np.append(PRIOR, [0.3, 0.3, 0.3])
    fine = check_camera(moved, images, *ruler, poses, prior=prior)
    if fine is None or np.linalg.norm(fine.parameters[:3]) > _REPLACED or fine.sigma[:3].max() > misfit.sigma[:3].max():
        return mounting, misfit
    focal = float(camera.rectifier.pinhole.matrix[0, 0])
    return turned(mounting, fine.parameters), replace(fine, scale=fine.scale / focal)


def render_mountings(results: Sequence[EstimatedMounting]) -> RenderableType:
    """Return the results of all sensors with their rig lines, for `rich.print`."""
    text = Text()
    for index, one in enumerate(results, start=1):
        text.append(f"{index}. ").append_text(one.__rich__()).append("\n")
    return text
