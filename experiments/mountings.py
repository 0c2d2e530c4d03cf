"""How well mountings are estimated from guesses that are far off: `offpiste inspect --estimate-mountings`.

Every sensor of a log is rotated about a random axis, with another axis for each seed, and estimated anew; the log's own
mountings are the truth. `python -m experiments.mountings LOG... --rig kitti --seeds 10 --degrees 10`.
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import tyro
from rich.table import Table
from scipy.spatial.transform import Rotation

from experiments.command import run
from offpiste.inspection.estimated_mounting import EstimatedMounting
from offpiste.inspection.misfit import turned
from offpiste.inspection.mountings import estimated, given_places
from offpiste.inspection.sensor_samples import gather, small_camera
from offpiste.logs import open_log
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.progress import track
from offpiste.rig.rig import Rig, load_rig

logger = logging.getLogger("experiments")


@dataclass(frozen=True)
class Outcome:
    """Error of one estimate.

    Attributes:
        error: angle between the estimated mounting and the log's [deg]; NaN if it was refused.
        sigma: the estimate's own standard deviation, of its three angles together [deg].
        before, after: residuals, [m] for LiDARs, [px] for cameras.
    """

    log: str
    sensor: str
    seed: int
    error: float
    sigma: float
    before: float
    after: float
    refused: str


def outcomes(path: str, rig: Rig, seeds: int, degrees: float) -> Iterator[Outcome]:
    """Estimates of all sensors of a log, from every seed's guess; images and scans are read once."""
    log = open_log(path)
    sensors = open_sensors(log, rig)
    cameras = {name: small_camera(camera) for name, camera in sensors.cameras.items()}
    gathered = gather(sensors, cameras)
    places = given_places(log, rig)
    for seed in track(range(seeds), path):
        rng = np.random.default_rng(seed)
        turns = {name: _turn(degrees, rng) for name in (*sensors.lidars, *sensors.cameras)}
        wrong = _turned_sensors(sensors, turns)
        wrong_cameras = {name: replace(one, camera=wrong.cameras[name]) for name, one in cameras.items()}
        given = {name: (turned(places[name][0], turns[name]), places[name][1]) for name in turns}
        for one in estimated(wrong, wrong_cameras, gathered, given):
            yield _outcome(path, seed, one, places[one.name][0])


def _outcome(path: str, seed: int, one: EstimatedMounting, truth: np.ndarray) -> Outcome:
    error = float(Rotation.from_matrix(one.mounting[:3, :3] @ truth[:3, :3].T).magnitude())
    sigma = float(np.linalg.norm(one.sigma))
    known = np.nan if one.refused else np.rad2deg(error)
    return Outcome(path, one.name, seed, known, np.rad2deg(sigma), one.before, one.after, one.refused)


def _turn(degrees: float, rng: np.random.Generator) -> np.ndarray:
    axis = rng.standard_normal(3)
    return np.append(np.deg2rad(degrees) * axis / np.linalg.norm(axis), 0.0)


def _turned_sensors(sensors: SensorLog, turns: dict[str, np.ndarray]) -> SensorLog:
    cameras = {n: replace(c, body_from_camera=turned(c.body_from_camera, turns[n])) for n, c in sensors.cameras.items()}
    lidars = {n: replace(d, body_from_lidar=turned(d.body_from_lidar, turns[n])) for n, d in sensors.lidars.items()}
    return SensorLog(open_log(sensors.path), sensors.rig, cameras, lidars, sensors.poses, [])


def tabulate(results: Sequence[Outcome]) -> Table:
    """A row for each log and sensor."""
    table = Table(box=None)
    for name in ("log", "sensor", "estimated", r"error, median / worst \[deg]", r"own sigma \[deg]", "before", "after"):
        table.add_column(name)
    for log, sensor in dict.fromkeys((one.log, one.sensor) for one in results):
        rows = [one for one in results if (one.log, one.sensor) == (log, sensor)]
        kept = [one for one in rows if not one.refused]
        cells = [f"{len(kept)}/{len(rows)}"]
        if kept:
            errors = [one.error for one in kept]
            cells.append(f"{np.median(errors):.2f} / {max(errors):.2f}")
            cells += [f"{np.median([getattr(one, k) for one in kept]):.2g}" for k in ("sigma", "before", "after")]
        table.add_row(log.rstrip("/").rpartition("/")[2], sensor, *cells)
        for reason in dict.fromkeys(one.refused for one in rows if one.refused):
            table.add_row("", "", reason)
    return table


def main(
    logs: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="LOG...")],
    rig: str = "proving_ground",
    seeds: int = 10,
    degrees: float = 10.0,
) -> None:
    """Rotate the guesses of all mountings, and estimate them.

    Args:
        logs: logs with cameras and LiDARs, whose own mountings are the truth.
        rig: a preset's name or a rig file.
        seeds: number of guesses, each with random axes of its own.
        degrees: angle between a guess and the truth.
    """
    results: list[Outcome] = []
    for path in logs:
        results += outcomes(path, load_rig(rig), seeds, degrees)
    logger.info(tabulate(results))


if __name__ == "__main__":
    run(main)
