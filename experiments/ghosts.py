"""What returns below the ground do to the map, and what is left of that once they are found.

`python -m experiments.ghosts LOG --rig NAME`: the ground that the map holds under the wheels, as they leave it,
against the height of the vehicle itself, with ghosts in the map and without. `--planted 0.001` adds ghosts to every
scan: returns from up to 13 m below the ground, further along their rays. `--drift 0.5` lets the pose's height wander by
so much in 8 s. With `--pca` the valid rates of a dataset by distance are compared, too.
"""

import logging
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from jaxtyping import Float

from experiments.command import run
from offpiste.conventions import FEATURE_SETS
from offpiste.dataset.extract import make_dataset
from offpiste.inspection.map_health import check_map_health, map_health
from offpiste.inspection.sensor_samples import gather
from offpiste.logs.measurements import Cloud
from offpiste.logs.opening import open_log
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.mapping.ghosts import GhostSettings
from offpiste.mapping.pipeline import FeatureCloud, MapPipeline, MapSettings
from offpiste.mapping.replay import MapperSettings
from offpiste.mapping.terrain_map import wheel_positions
from offpiste.perception.motion_compensation import points_in_world
from offpiste.rig.rig import load_rig

logger = logging.getLogger("experiments")

DEEPEST = 13.0
"""Depth of the deepest planted ghost [m]."""
PERIOD = 16.0
"""Period of the wandering height: from one extreme to the other in 8 s [s]."""
_NEAR = 15.0
"""The ground under a wheel is what the map held last within this distance of the vehicle [m]."""


@dataclass(frozen=True)
class UnderWheels:
    """The map's ground under the wheels against their own height; their middle difference counts as none.

    Attributes:
        known: share of places with ground.
        wrong: share of the known ones that is off by more than 1 m.
        lowest: difference of the lowest [m].
        ghosts: share of returns found to be ghosts.
    """

    known: float
    wrong: float
    lowest: float
    ghosts: float

    def __str__(self) -> str:
        return (
            f"ground known under {self.known:.3f} of the places, {self.wrong:.2%} of it off by more than 1 m "
            f"(lowest {self.lowest:+.2f} m); {self.ghosts:.4%} of the returns left out"
        )


def under_wheels(log: SensorLog, settings: MapSettings, *, planted: float = 0.0, seconds: float = 60.0) -> UnderWheels:
    """Play the scans of a log into a map, and compare its ground with the wheels' height.

    Args:
        planted: share of ghosts that is added.
    """
    begin, end = log.poses.span
    end = min(end, begin + seconds)
    wheels = _wheels(log, np.arange(begin, end, 0.05))
    rng, pipeline, layers = np.random.default_rng(0), MapPipeline(0, settings), None
    ground, left_out, total = np.full(len(wheels), np.nan), 0, 0
    for pose, sensor, points in _scans(log, end):
        scan = with_ghosts(points, sensor, planted, rng)
        left_out += int(pipeline.add(FeatureCloud(scan, sensor), pose[:3, 3]).sum())
        total += len(scan)
        layers = pipeline.layers(layers)
        near = np.flatnonzero(np.linalg.norm(wheels[:, :2] - pose[:2, 3], axis=1) < _NEAR)
        column, row = np.round((wheels[near, :2] - layers.origin) / layers.resolution).astype(int).T
        held = layers.elevation[row, column]
        ground[near] = np.where(np.isfinite(held), held, ground[near])
    off = ground - wheels[:, 2]
    off = off[np.isfinite(off)] - np.nanmedian(off)
    return UnderWheels(len(off) / len(wheels), float((np.abs(off) > 1).mean()), float(off.min()), left_out / total)


def _scans(log: SensorLog, end: float) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Pose, place of the sensor, and points in the world of each scan whose poses are known."""
    for scan in log.stream(list(log.lidars), end=end):
        assert isinstance(scan, Cloud)
        pose, lidar = log.poses.at(np.array([scan.time]))[0], log.lidars[scan.lidar]
        if np.isfinite(pose).all():
            points = points_in_world(scan, lidar, log.poses)
            yield pose, (pose @ lidar.body_from_lidar)[:3, 3], points[np.isfinite(points).all(axis=1)]


def _wheels(log: SensorLog, times: np.ndarray) -> Float[np.ndarray, "n 3"]:
    """Places of the wheels, at the height of the pose point."""
    poses = log.poses.at(times)
    poses = poses[np.isfinite(poses).all(axis=(1, 2))]
    yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    places = wheel_positions(poses[:, :2, 3], yaw, log.rig.wheel_positions())
    tilt = poses[:, 2, :2] @ log.rig.wheel_positions().T  # what pitch and roll do to the height of a wheel
    height = poses[:, None, 2, 3] + tilt
    return np.concatenate((places, height[..., None]), axis=2).reshape(-1, 3)


def with_ghosts(
    points: Float[np.ndarray, "n 3"], sensor: Float[np.ndarray, " 3"], share: float, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Points of which a share, of those whose rays point down, lie further along their rays, 0.7 to 13 m lower."""
    if share <= 0:
        return points
    rays = points - sensor
    steep = np.flatnonzero(rays[:, 2] < -0.035 * np.linalg.norm(rays[:, :2], axis=1))
    chosen = rng.choice(steep, min(round(share * len(points)), len(steep)), replace=False)
    result = points.copy()
    result[chosen] += rays[chosen] * (rng.uniform(0.7, DEEPEST, len(chosen)) / -rays[chosen, 2])[:, None]
    return result


def drifting(log: SensorLog, metres: float) -> SensorLog:
    """The log with a pose whose height goes up and down by so much, each in 8 s."""
    position = log.poses.position
    values = position.values.copy()
    values[:, 2] += metres * np.abs((position.time - position.time[0]) / (PERIOD / 2) % 2 - 1)
    log.poses = replace(log.poses, position=replace(position, values=values))
    return log


def valid_rates(drive: Path, rig: str, pca: Path, settings: MapSettings) -> str:
    """Valid rates by distance of a dataset that is made of a drive."""
    with tempfile.TemporaryDirectory() as folder:
        replay = MapperSettings(map=settings)
        out = Path(folder) / "dataset.zarr"
        dataset = make_dataset([drive], load_rig(rig), out, split="blocks:1,0,0", pca=pca, replay=replay, force=True)
        cells = dataset.drives[0].rows.cells
        assert cells is not None
        return ", ".join(
            f"{name} {rate:.2f}" for name, rate in zip(FEATURE_SETS, cells.valid.mean(axis=1), strict=True)
        )


def main(
    log: tyro.conf.Positional[Path],
    rig: str = "proving_ground",
    planted: float = 0.0,
    drift: float = 0.0,
    seconds: float = 60.0,
    pca: Path | None = None,
) -> None:
    """Compare the map with ghosts in it and without, and print what `inspect` says.

    Args:
        log: a drive with LiDARs.
        rig: name of a preset, or a rig file.
        planted: share of ghosts that is added to every scan.
        drift: of the pose's height in 8 s [m].
        seconds: length of the stretch that is played, from the first pose [s].
        pca: a file of `fit-pca`, for valid rates.
    """
    sensors = drifting(open_sensors(open_log(log), load_rig(rig)), drift)
    variants = {"ghosts in the map": MapSettings(ghosts=None), "left out": MapSettings(ghosts=GhostSettings())}
    for name, settings in variants.items():
        logger.info(f"{name}: {under_wheels(sensors, settings, planted=planted, seconds=seconds)}")
        if pca is not None:
            logger.info(f"  valid by distance: {valid_rates(log, rig, pca, settings)}")
    health = map_health(sensors.lidars, gather(sensors, {}), sensors.poses)
    logger.info(str(health))
    for finding in check_map_health(health):
        logger.info(f"{finding.severity}: {finding.where} {finding.what} ({finding.evidence})")


if __name__ == "__main__":
    run(main)
