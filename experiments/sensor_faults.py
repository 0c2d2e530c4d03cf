"""Recorded sensors under a wrong belief: cameras mounted a little otherwise, images taken at another moment.

From what error on `offpiste inspect` finds a turned or delayed camera or LiDAR.

Faults are planted in the measurements of a log, one sensor and one fault at a time: mountings are turned about a random
axis, stamps are moved. `python -m experiments.sensor_faults LOG... --rig proving_ground`.
"""

import logging
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Annotated, Final

import msgspec
import numpy as np
import tyro
from jaxtyping import Float
from rich.table import Table
from scipy.spatial.transform import Rotation

from experiments.command import run
from offpiste.inspection.misfit import turned
from offpiste.inspection.mountings import CheckedSensor
from offpiste.inspection.sensor_samples import Gathered, SmallCamera, gather, small_camera
from offpiste.inspection.sensors import camera_misfits, lidar_misfits
from offpiste.logs import open_log
from offpiste.logs.channel import Channel
from offpiste.logs.measurements import Camera, Lidar
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.progress import track
from offpiste.rig.rig import Rig, load_rig

logger = logging.getLogger("experiments")


@dataclass(frozen=True)
class Flaw:
    """What is believed wrongly of every camera; LiDARs and poses are left alone.

    Attributes:
        degrees: angle between believed and true mounting.
        direction: seed of the axes that cameras are turned about, one drawn for each from all directions alike.
        late: how much later than it was an image is believed to have been taken [s].
    """

    degrees: float = 0.0
    direction: int = 0
    late: float = 0.0

    def __str__(self) -> str:
        return f"{self.degrees:g}deg{self.direction}-{1000 * self.late:g}ms"


def perturbed(log: SensorLog, flaw: Flaw) -> SensorLog:
    """The same log, its cameras believed wrongly; the log given stays as it is."""
    rng = np.random.default_rng(flaw.direction)
    other = copy(log)
    other.cameras = {name: _perturbed(camera, flaw, rng) for name, camera in log.cameras.items()}
    return other


def stretch(log: SensorLog, start: float, end: float) -> SensorLog:
    """The same log with its poses known from `start` to `end` [s] only: nothing else of it is mapped."""
    other = copy(log)
    position, orientation = (_cut(c, start, end) for c in (log.poses.position, log.poses.orientation))
    other.poses = replace(log.poses, position=position, orientation=orientation)
    return other


def turn(degrees: float, rng: np.random.Generator) -> Float[np.ndarray, "4 4"]:
    """A rotation by an angle about an axis drawn from all directions alike."""
    axis = rng.normal(size=3)
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(np.deg2rad(degrees) * axis / np.linalg.norm(axis)).as_matrix()
    return matrix


def _perturbed(camera: Camera, flaw: Flaw, rng: np.random.Generator) -> Camera:
    mounting = camera.body_from_camera @ turn(flaw.degrees, rng)
    # A delay is taken off the stamps: less of it makes images later.
    source = msgspec.structs.replace(camera.source, delay=camera.source.delay - flaw.late)
    return replace(camera, body_from_camera=mounting, source=source)


def _cut(channel: Channel, start: float, end: float) -> Channel:
    inside = (channel.time >= start) & (channel.time <= end)
    return replace(channel, time=channel.time[inside], values=channel.values[inside])


TURNS: Final = (0.0, 0.5, 1.0, 2.0, 3.0)
"""[deg]."""
DELAYS: Final = (20.0, 50.0, 100.0)
"""[ms]; 0 is the first of `TURNS`."""


@dataclass(frozen=True)
class Fault:
    """What is planted in one sensor.

    Attributes:
        kind: "camera" or "lidar".
        turn: [deg], about a random axis.
        late: [ms].
    """

    kind: str
    turn: float
    late: float


@dataclass(frozen=True)
class Outcome:
    """What became of a fault.

    Attributes:
        turned, late: whether a finding said so of that sensor.
        other: whether another sensor was accused.
        turn_error: angle that the found turn leaves of the planted one [deg]; late_error: likewise [ms].
    """

    fault: Fault
    turned: bool
    late: bool
    other: bool
    turn_error: float
    late_error: float


def faults() -> Iterator[Fault]:
    """All of the table."""
    for kind in ("camera", "lidar"):
        yield from (Fault(kind, turn, 0.0) for turn in TURNS)
        yield from (Fault(kind, 0.0, late) for late in DELAYS)


def outcomes(path: str, rig: Rig, rng: np.random.Generator) -> Iterator[Outcome]:
    """Every fault in the first camera and LiDAR of a log."""
    sensors = open_sensors(open_log(path), rig)
    cameras = {name: small_camera(camera) for name, camera in sensors.cameras.items()}
    gathered = gather(sensors, cameras)
    clean = lidar_misfits(sensors.lidars, gathered, sensors.poses)
    for fault in track(list(faults()), path):
        axis = rng.standard_normal(3)
        turn, late = np.deg2rad(fault.turn) * axis / np.linalg.norm(axis), fault.late / 1e3
        name = next(iter(cameras if fault.kind == "camera" else sensors.lidars))
        lidars, turned_cameras, moved = planted(sensors.lidars, cameras, gathered, name, turn, late)
        judged = clean if name in cameras else lidar_misfits(lidars, moved, sensors.poses)
        judged = judged + camera_misfits(turned_cameras, judged, moved, sensors.poses)
        accused = {one.sensor.name: one for one in judged}
        mine = accused.pop(name)
        other = any(one.is_turned or one.is_late for one in accused.values())
        yield Outcome(fault, mine.is_turned, mine.is_late, other, *_errors(mine, turn, late))


def planted(
    lidars: dict[str, Lidar],
    cameras: dict[str, SmallCamera],
    gathered: Gathered,
    name: str,
    turn: Float[np.ndarray, " 3"],
    late: float,
) -> tuple[dict[str, Lidar], dict[str, SmallCamera], Gathered]:
    """The same measurements, those of one sensor mounted and stamped wrongly; nothing given is changed.

    Args:
        turn: by which the mounting is wrong, about the body's axes [rad].
        late: of its stamps [s].
    """
    parameters = np.append(turn, 0.0)
    if name in cameras:
        camera = cameras[name].camera
        wrong = replace(camera, body_from_camera=turned(camera.body_from_camera, parameters))
        images = [replace(image, time=image.time + late) for image in gathered.images[name]]
        cameras = {**cameras, name: replace(cameras[name], camera=wrong)}
        return lidars, cameras, replace(gathered, images={**gathered.images, name: images})
    lidar = lidars[name]
    lidars = {**lidars, name: replace(lidar, body_from_lidar=turned(lidar.body_from_lidar, parameters))}
    scans = [replace(scan, moments=scan.moments + late, time=scan.time + late) for scan in gathered.scans[name]]
    return lidars, cameras, replace(gathered, scans={**gathered.scans, name: scans})


def _errors(found: CheckedSensor, turn: Float[np.ndarray, " 3"], late: float) -> tuple[float, float]:
    """How far the found turn [deg] and lateness [ms] are from the planted ones; NaN where nothing was found."""
    if found.misfit is None:
        return np.nan, np.nan
    left = Rotation.from_rotvec(found.misfit.parameters[:3]) * Rotation.from_rotvec(turn)
    return float(np.rad2deg(left.magnitude())), float(1e3 * abs(found.misfit.parameters[3] - late))


def tabulate(found: Sequence[Outcome]) -> Table:
    """Share of the logs in which each fault was found."""
    table = Table(box=None)
    for name in ("fault", "logs", "said to be turned", "said late or early", "another accused"):
        table.add_column(name)
    table.add_column(r"turn\'s error, median / worst \[deg]")
    table.add_column(r"lateness\'s error, median / worst \[ms]")
    for fault in faults():
        rows = [one for one in found if one.fault == fault]
        said = [f"{sum(flags)}/{len(rows)}" for flags in zip(*((r.turned, r.late, r.other) for r in rows), strict=True)]
        errors = np.array([(r.turn_error, r.late_error) for r in rows])
        worst = [f"{np.nanmedian(e):.2f} / {np.nanmax(e):.2f}" for e in errors.T]
        what = f"{fault.kind}: {f'{fault.late:g} ms' if fault.late else f'{fault.turn:g} degrees'}"
        table.add_row(what, str(len(rows)), *said, *worst)
    return table


def main(
    logs: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="LOG...")],
    rig: str = "proving_ground",
    seed: int = 0,
) -> None:
    """Plant faults in logs, and say which are found.

    Args:
        logs: with cameras and LiDARs.
        rig: a preset's name or a rig file.
        seed: of the axes of turns.
    """
    found: list[Outcome] = []
    for number, path in enumerate(logs):
        found += outcomes(path, load_rig(rig), np.random.default_rng((seed, number)))
    logger.info(tabulate(found))


if __name__ == "__main__":
    run(main)
