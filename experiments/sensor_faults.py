"""How large a mounting or stamp error must be for `offpiste inspect` to find it, in cameras and LiDARs.

Faults are planted in the measurements of a log, one sensor and one fault at a time: mountings are rotated about a
random axis, stamps are shifted. `python -m experiments.sensor_faults LOG... --rig proving_ground`.
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Final

import numpy as np
import tyro
from jaxtyping import Float
from rich.table import Table
from scipy.spatial.transform import Rotation

from experiments.command import run
from offpiste.core.progress import track
from offpiste.inspection.misfit import turned
from offpiste.inspection.sensor_samples import Gathered, SmallCamera, gather, small_camera
from offpiste.inspection.sensors import CheckedSensor, camera_misfits, lidar_misfits
from offpiste.logs import open_log
from offpiste.logs.measurements import Lidar
from offpiste.logs.sensor_log import open_sensors
from offpiste.rig.rig import Rig, load_rig

logger = logging.getLogger("experiments")


TURNS: Final = (0.0, 0.5, 1.0, 2.0, 3.0)
"""Planted rotations [deg]."""
DELAYS: Final = (20.0, 50.0, 100.0)
"""Planted delays [ms]; no delay is the first of `TURNS`."""


@dataclass(frozen=True)
class Fault:
    """Fault planted in one sensor.

    Attributes:
        kind: "camera" or "lidar".
        turn: rotation of the mounting about a random axis [deg].
        late: delay of the stamps [ms].
    """

    kind: str
    turn: float
    late: float


@dataclass(frozen=True)
class Outcome:
    """Result for one planted fault.

    Attributes:
        turned, late: whether a finding reported that fault of that sensor.
        other: whether a finding reported another sensor.
        turn_error: angle between the estimated and the planted rotation [deg].
        late_error: difference of the estimated and the planted delay [ms].
    """

    fault: Fault
    turned: bool
    late: bool
    other: bool
    turn_error: float
    late_error: float


def faults() -> Iterator[Fault]:
    """All faults of the table."""
    for kind in ("camera", "lidar"):
        yield from (Fault(kind, turn, 0.0) for turn in TURNS)
        yield from (Fault(kind, 0.0, late) for late in DELAYS)


def outcomes(path: str, rig: Rig, rng: np.random.Generator) -> Iterator[Outcome]:
    """Results of every fault in the first camera and LiDAR of a log."""
    sensors = open_sensors(open_log(path), rig)
    cameras = {name: small_camera(camera) for name, camera in sensors.cameras.items()}
    gathered = gather(sensors, cameras)
    clean = lidar_misfits(sensors.lidars, gathered, sensors.poses)
    for fault in track(list(faults()), path):
        axis = rng.standard_normal(3)
        turn, late = np.deg2rad(fault.turn) * axis / np.linalg.norm(axis), fault.late / 1e3
        name = next(iter(cameras if fault.kind == "camera" else sensors.lidars))
        lidars, turned_cameras, moved = planted(sensors.lidars, cameras, gathered, name, turn, late)
        checked = clean if name in cameras else lidar_misfits(lidars, moved, sensors.poses)
        checked = checked + camera_misfits(turned_cameras, checked, moved, sensors.poses)
        checked_by_name = {one.sensor.name: one for one in checked}
        mine = checked_by_name.pop(name)
        other = any(one.is_turned or one.is_late for one in checked_by_name.values())
        yield Outcome(fault, mine.is_turned, mine.is_late, other, *_errors(mine, turn, late))


def planted(
    lidars: dict[str, Lidar],
    cameras: dict[str, SmallCamera],
    gathered: Gathered,
    name: str,
    turn: Float[np.ndarray, " 3"],
    late: float,
) -> tuple[dict[str, Lidar], dict[str, SmallCamera], Gathered]:
    """Copies of the measurements with a wrong mounting and wrong stamps of one sensor.

    Args:
        turn: error of the mounting about the body's axes [rad].
        late: delay of its stamps [s].
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


def _errors(result: CheckedSensor, turn: Float[np.ndarray, " 3"], late: float) -> tuple[float, float]:
    """Errors of the estimated rotation [deg] and delay [ms]; NaN where nothing was found."""
    if result.misfit is None:
        return np.nan, np.nan
    left = Rotation.from_rotvec(result.misfit.parameters[:3]) * Rotation.from_rotvec(turn)
    return float(np.rad2deg(left.magnitude())), float(1e3 * abs(result.misfit.parameters[3] - late))


def tabulate(results: Sequence[Outcome]) -> Table:
    """Share of the logs in which each fault was found."""
    table = Table(box=None)
    for name in ("fault", "logs", "rotation found", "delay found", "another sensor reported"):
        table.add_column(name)
    table.add_column(r"error of the rotation, median / worst \[deg]")
    table.add_column(r"error of the delay, median / worst \[ms]")
    for fault in faults():
        rows = [one for one in results if one.fault == fault]
        counts = [
            f"{sum(flags)}/{len(rows)}" for flags in zip(*((r.turned, r.late, r.other) for r in rows), strict=True)
        ]
        errors = np.array([(r.turn_error, r.late_error) for r in rows])
        worst = [f"{np.nanmedian(e):.2f} / {np.nanmax(e):.2f}" for e in errors.T]
        what = f"{fault.kind}: {f'{fault.late:g} ms' if fault.late else f'{fault.turn:g} degrees'}"
        table.add_row(what, str(len(rows)), *counts, *worst)
    return table


def main(
    logs: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="LOG...")],
    rig: str = "proving_ground",
    seed: int = 0,
) -> None:
    """Plant faults in logs, and count those that are found.

    Args:
        logs: logs with cameras and LiDARs.
        rig: a preset's name or a rig file.
        seed: seed of the rotation axes.
    """
    results: list[Outcome] = []
    for number, path in enumerate(logs):
        results += outcomes(path, load_rig(rig), np.random.default_rng((seed, number)))
    logger.info(tabulate(results))


if __name__ == "__main__":
    run(main)
