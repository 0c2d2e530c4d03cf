"""The map that a vehicle had around itself, from a bag with LiDARs and poses: elevation, slope and obstacles.

    python examples/map_from_bag.py drive.mcap --rig proving_ground --seconds 20

With --pca (see `offpiste fit-pca`) the cells hold visual features of the cameras, too.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

import offpiste
from offpiste.logs.sensor_log import open_sensors
from offpiste.mapping.replay import pinhole_cameras
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.perception.feature_extractor import load_feature_extractor


def no_features(pixels: np.ndarray) -> np.ndarray:
    """Stand for a feature extractor where no camera is read."""
    raise NotImplementedError


def build_map(log: str, rig: str, *, pca: str = "", seconds: float = np.inf) -> tuple[TerrainLayers, np.ndarray]:
    """Layers of the map after some seconds, and the vehicle's position then [m]."""
    sensors = open_sensors(offpiste.open_log(log), offpiste.load_rig(rig))
    if pca:
        extractor = load_feature_extractor(Path(pca))
        cameras, features, channels = pinhole_cameras(sensors, extractor.patch), extractor.extract, extractor.channels
    else:
        cameras, features, channels = {}, no_features, 0
    first, last = sensors.poses.span
    for moment in offpiste.replay(sensors, cameras, features, channels, end=min(first + seconds, last)):
        layers, position = moment.layers, moment.vehicle
    return layers, position


def draw(layers: TerrainLayers, position: np.ndarray, out: str) -> None:
    """A picture of the layers from above."""
    ny, nx = layers.known.shape
    x, y = layers.origin
    box = (x, x + nx * layers.resolution, y, y + ny * layers.resolution)
    panels = {
        "elevation [m]": (layers.elevation, "terrain"),
        "slope (rise over run)": (np.clip(layers.slope, 0, 0.6), "Greys"),
        "obstacle height [m]": (np.where(layers.obstacle_height > 0.2, layers.obstacle_height, np.nan), "YlOrRd"),
        "first feature": (
            layers.features[..., 0] if layers.features.shape[2] else np.full((ny, nx), np.nan),
            "viridis",
        ),
    }
    figure, axes = plt.subplots(2, 2, figsize=(11, 9), layout="constrained", sharex=True, sharey=True)
    for panel, (title, (values, colours)) in zip(axes.flat, panels.items(), strict=True):
        figure.colorbar(panel.imshow(values, origin="lower", extent=box, cmap=colours), ax=panel, shrink=0.8)
        panel.plot(*position[:2], "k^")
        panel.set(title=title, xlabel="x [m]", ylabel="y [m]")
    figure.savefig(out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log")
    parser.add_argument("--rig", required=True, help="name of a preset, or a rig file")
    parser.add_argument("--pca", default="", help="a file that `offpiste fit-pca` wrote")
    parser.add_argument("--seconds", type=float, default=np.inf, help="of the drive that go into the map")
    parser.add_argument("--out", default="map.png")
    given = parser.parse_args()
    layers, position = build_map(given.log, given.rig, pca=given.pca, seconds=given.seconds)
    draw(layers, position, given.out)
    print(f"{given.out}: {layers.known.sum() * layers.resolution**2:.0f} m2 of ground, {layers.valid.mean():.0%} seen")
