"""One forest frame of MonoForce's tracked robot: points in four distorted cameras, and the map of one LiDAR scan.

Depth edges fall on image edges where extrinsics and stamps are right (after Levinson and Thrun, "Automatic Online
Calibration of Cameras and Lasers", RSS 2013, section III).

`python -m experiments.marv ../shared/data/monoforce_marv --out marv`
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import torch
import tyro
from jaxtyping import Float, Float32, UInt8
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation

from experiments.command import run
from experiments.map_picture import map_picture
from offpiste.errors import LogError
from offpiste.logs.measurements import Camera
from offpiste.mapping.pipeline import FeatureCloud, MapPipeline
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.perception.backbones import Backbone, open_backbone
from offpiste.perception.camera import make_pinhole_camera
from offpiste.perception.feature_extractor import FeatureExtractor
from offpiste.perception.motion_compensation import transformed
from offpiste.perception.pca import Moments, fit
from offpiste.perception.projection import CameraView, project
from offpiste.report.feature_colours import colour_limits, colours
from offpiste.rig.camera import CameraModel
from offpiste.rig.sensors import CameraSource
from offpiste.visualization.images import beside, overlay, sheet, write_png

logger = logging.getLogger("experiments")

_CELL: Final = np.deg2rad(0.35)
"""Cell of the range image: the spacing of a LiDAR's columns or a little more [rad]."""
_APART: Final = 3
"""Neighbours are looked for as far as so many cells to either side: where no echo came back, there is none."""


def depth_edges(points_lidar: Float[np.ndarray, "n 3"], *, least: float = 1.0) -> Float[np.ndarray, " n"]:
    """Depth step at each point to its left or right neighbour, square root of metres; 0 for most.

    Edges belong to the nearer side, and only edges across the turning direction count: along it a LiDAR is dense.

    Args:
        points_lidar: one scan in its sensor's frame.
        least: smaller steps are no edge [m].
    """
    distance = np.linalg.norm(points_lidar, axis=1)
    azimuth = np.arctan2(points_lidar[:, 1], points_lidar[:, 0])
    elevation = np.arcsin(np.clip(points_lidar[:, 2] / np.maximum(distance, 1e-9), -1, 1))
    columns = int(np.round(2 * np.pi / _CELL))
    column = np.floor(azimuth / (2 * np.pi) * columns).astype(np.int64) % columns
    row = np.floor((elevation + np.pi / 2) / _CELL).astype(np.int64)
    image = np.full((int(row.max(initial=0)) + 1, columns), np.nan)
    image[row, column] = distance
    step = np.zeros(len(distance))
    for side in (-1, 1):
        beside = np.full(len(distance), np.nan)
        for away in range(_APART, 0, -1):
            result = image[row, (column + side * away) % columns]
            beside = np.where(np.isfinite(result), result, beside)
        step = np.fmax(step, beside - distance)
    return np.sqrt(np.where(step > least, step, 0.0))


def image_edges(image: UInt8[np.ndarray, "h w 3"], *, blur: float = 2.0) -> Float32[np.ndarray, "h w"]:
    """How near each pixel is to upright edges of brightness, 1 on average.

    Args:
        blur: over which edges are felt [px].
    """
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.5)
    # Relative to the contrast around it: an edge in the shadow counts like one in the sun.
    gradient = np.abs(cv2.Sobel(smooth, cv2.CV_32F, 1, 0))
    gradient /= cv2.GaussianBlur(gradient, (0, 0), 40.0) + 0.5
    felt = cv2.GaussianBlur(gradient, (0, 0), blur)
    return np.asarray(felt / felt.mean(), np.float32)


def edge_score(
    edges: Float32[np.ndarray, "h w"], pixels: Float[np.ndarray, "n 2"], strength: Float[np.ndarray, " n"]
) -> float:
    """Mean of the image's edges at the points' pixels, weighted by their depth edges: 1 by chance, more if they agree.

    NaN without a depth edge.
    """
    used = strength > 0
    column, row = np.rint(pixels[used]).astype(np.int64).T
    total = strength[used].sum()
    return float((edges[row, column] * strength[used]).sum() / total) if total > 0 else float("nan")


CAMERAS = ("camera_front", "camera_left", "camera_rear", "camera_right")
SIZE = (960, 600)
"""Width and height of rectified images [px]; they are recorded at twice that, and all four are out of focus nearby."""
TURNS = (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0)
"""About each axis of a camera, by which its mounting is falsified [deg]."""


@dataclass(frozen=True)
class Frame:
    """One moment of a robot that is taken to stand still and level: its body frame is the world.

    Attributes:
        views: views of the rectified cameras.
        images: rectified, in the order of the views.
        points_lidar: points with an echo [m].
        body_from_lidar: where the LiDAR sits.
    """

    views: tuple[CameraView, ...]
    images: tuple[UInt8[np.ndarray, "h w 3"], ...]
    points_lidar: Float[np.ndarray, "n 3"]
    body_from_lidar: Float[np.ndarray, "4 4"]

    @property
    def points_body(self) -> Float[np.ndarray, "n 3"]:
        """The same points in the body frame [m]."""
        return transformed(self.points_lidar, self.body_from_lidar)


def read_frame(folder: Path) -> Frame:
    """The first frame of a folder in MonoForce's layout.

    Raises:
        LogError: a file is missing or holds something else.
    """
    clouds = sorted((folder / "clouds").glob("*.npz"))
    if not clouds:
        raise LogError("no clouds/*.npz", where=folder, how="give MonoForce's folder of one frame")
    mountings = _yaml(folder / "calibration" / "transformations.yaml")
    cameras, images = [], []
    for name in CAMERAS:
        given = _yaml(folder / "calibration" / "cameras" / f"{name}.yaml")
        matrix = np.array(given["camera_matrix"]["data"], np.float64).reshape(3, 3)
        distortion = tuple(float(number) for number in given["distortion_coefficients"]["data"])
        model = CameraModel(int(given["image_width"]), int(given["image_height"]), matrix, distortion)
        source = Camera(name, model, _mounting(mountings, name), CameraSource(topic=name))
        cameras.append(make_pinhole_camera(source, 14, size=SIZE))
        path = folder / "images" / f"{clouds[0].stem}_{name}.png"
        picture = cv2.imread(str(path))
        if picture is None:
            raise LogError("no picture", where=path, how="give MonoForce's folder of one frame")
        images.append(np.ascontiguousarray(np.asarray(picture, np.uint8)[:, :, ::-1]))
    with np.load(clouds[0], allow_pickle=False) as content:
        cloud = content["cloud"]
    points = np.stack([cloud[axis] for axis in "xyz"], axis=1).astype(np.float64)
    points = points[np.linalg.norm(points, axis=1) > 0.5]  # false for NaN; nearer is the robot itself
    return Frame(
        tuple(CameraView(camera, 0.0, camera.body_from_camera) for camera in cameras),
        tuple(camera.rectifier(image) for camera, image in zip(cameras, images, strict=True)),
        points,
        _mounting(mountings, "os_sensor"),
    )


def overlays(frame: Frame) -> list[UInt8[np.ndarray, "h w 3"]]:
    """Each image with the points that it shows."""
    drawn = []
    for view, image in zip(frame.views, frame.images, strict=True):
        result = project(frame.points_body, [view])
        drawn.append(overlay(image, result.pixel[result.seen], result.distance[result.seen], farthest=30.0))
    return drawn


def edge_scores(frame: Frame, turns: tuple[float, ...] = TURNS) -> Float[np.ndarray, "cameras 3 turns"]:
    """The edge score of each camera, its mounting turned about its x (pitch), y (yaw) and z (roll) axis [deg]."""
    strength, points = depth_edges(frame.points_lidar), frame.points_body
    scores = np.zeros((len(frame.views), 3, len(turns)))
    for number, (view, image) in enumerate(zip(frame.views, frame.images, strict=True)):
        edges = image_edges(image)
        for axis in range(3):
            for index, turn in enumerate(turns):
                matrix = np.eye(4)
                matrix[:3, :3] = Rotation.from_rotvec(np.deg2rad(turn) * np.eye(3)[axis]).as_matrix()
                result = project(points, [replace(view, world_from_camera=view.world_from_camera @ matrix)])
                scores[number, axis, index] = edge_score(edges, result.pixel[result.seen], strength[result.seen])
    return scores


def fit_extractor(frame: Frame, backbone: Backbone, *, components: int = 20) -> FeatureExtractor:
    """Feature extractor with a PCA on all patches that points hit: a forest's ground is hard to segment."""
    result = project(frame.points_body, frame.views)
    moments = Moments.none(backbone.channels)
    for number, (view, image) in enumerate(zip(frame.views, frame.images, strict=True)):
        mask = view.camera.grid.hit(result.pixel[result.view == number])
        with torch.no_grad():
            moments = moments.add(backbone(image[None]), mask[None])
    return FeatureExtractor(backbone, fit(moments, backbone, components=components))


def terrain(frame: Frame, extractor: FeatureExtractor) -> TerrainLayers:
    """The map of the one scan, with the features of the images."""
    result = project(frame.points_body, frame.views)
    features = result.gather([extractor.extract(image) for image in frame.images])
    pipeline = MapPipeline(extractor.channels)
    cloud = FeatureCloud(frame.points_body, frame.body_from_lidar[:3, 3], features, result.seen)
    pipeline.add(cloud, np.zeros(3))
    return pipeline.layers()


def main(folder: tyro.conf.Positional[Path], out: Path = Path("marv"), backbone: str = "filterbank") -> None:
    """Draw a forest frame as overlay.png, features.png and map.png, and show its edge scores.

    Args:
        folder: folder with calibration, images and clouds.
        out: folder of the pictures.
        backbone: name of a backbone, as in `offpiste fit-pca`.
    """
    frame = read_frame(folder)
    extractor = fit_extractor(frame, open_backbone(backbone))
    looks = [extractor.extract(image) for image in frame.images]
    layers = terrain(frame, extractor)
    limits = colour_limits(np.concatenate([look.reshape(-1, extractor.channels) for look in looks]))
    out.mkdir(parents=True, exist_ok=True)
    pairs = zip(frame.views, frame.images, looks, strict=True)
    write_png(out / "overlay.png", sheet(overlays(frame)))
    write_png(
        out / "features.png",
        sheet([beside(i, colours(look, limits), v.camera.grid) for v, i, look in pairs], columns=1),
    )
    write_png(out / "map.png", map_picture(layers, np.zeros(2), reach=12.0, limits=limits, pixels=6))
    logger.info("edge score by turn [deg]:   " + "".join(f"{turn:7.1f}" for turn in TURNS))
    for name, scores in zip((*CAMERAS, "mean"), _with_mean(edge_scores(frame)), strict=True):
        for axis, row in zip(("pitch", "yaw", "roll"), scores, strict=True):
            logger.info(f"{name:14} {axis:12}" + "".join(f"{score:7.2f}" for score in row))


def _with_mean(scores: Float[np.ndarray, "n 3 k"]) -> Float[np.ndarray, "m 3 k"]:
    return np.concatenate((scores, scores.mean(axis=0, keepdims=True)))


def _mounting(mountings: Mapping[str, Any], name: str) -> Float[np.ndarray, "4 4"]:
    matrix = np.array(mountings[f"T_base_link__{name}"]["data"], np.float64).reshape(4, 4)
    # Written with three decimals: 0.707 is no rotation yet.
    u, _, vt = np.linalg.svd(matrix[:3, :3])
    matrix[:3, :3] = u @ vt
    return matrix


def _yaml(path: Path) -> Mapping[str, Any]:
    try:
        return YAML(typ="safe").load(path.read_text("utf-8"))
    except OSError as error:
        raise LogError("no calibration", where=path, how="give MonoForce's folder of one frame") from error


if __name__ == "__main__":
    run(main)
