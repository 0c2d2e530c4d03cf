"""Ground under the wheels of a simulated drive: its look from each distance, and its true properties."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from offpiste.core.conventions import WHEELS
from offpiste.dataset.resample import extract_rows
from offpiste.dataset.visual_features import with_visual_features
from offpiste.logs import read_drive
from offpiste.logs.ground_truth import GROUND_KINDS, GROUND_PROPERTIES, read_truth_map
from offpiste.logs.log import open_log
from offpiste.logs.sensor_log import open_sensors
from offpiste.mapping.replay import MapperSettings
from offpiste.mapping.terrain_map import wheel_positions
from offpiste.perception.backbones import Backbone
from offpiste.perception.feature_extractor import FeatureExtractor
from offpiste.perception.pca import PrincipalComponents
from offpiste.rig.rig import Rig
from offpiste.simulation.world.grids import read_grid

GROUND = (*GROUND_KINDS, "wetness")
"""Layers of the true ground: shares of each kind, and 0 dry to 1 wet."""


@dataclass(frozen=True)
class SeenCells:
    """Cells under the wheels, each counted once per pass, by feature set.

    Attributes:
        features: components of the backbone's features.
        colour: mean red, green, blue of the same patches in the camera image [0..1].
        valid: whether the map has features and colour.
        properties: true `GROUND_PROPERTIES` at the cell's centre.
        ground: true `GROUND` there.
        row: of the drive at 50 Hz when the first wheel entered the cell.
    """

    features: Float[np.ndarray, "D M F"]
    colour: Float[np.ndarray, "D M 3"]
    valid: Bool[np.ndarray, "D M"]
    properties: Float[np.ndarray, "M 4"]
    ground: Float[np.ndarray, "M 8"]
    row: Int[np.ndarray, " M"]


@final
class WithColour(Backbone):
    """A backbone and the mean red, green and blue of each patch."""

    def __init__(self, inner: Backbone) -> None:
        self._inner = inner
        self.name, self.patch, self.channels = f"{inner.name}+colour", inner.patch, inner.channels + 3

    @property
    def device(self) -> torch.device:
        """Device of the backbone."""
        return self._inner.device

    def settings(self) -> dict[str, Any]:
        """Settings of the backbone."""
        return {**self._inner.settings(), "colour": True}

    def _features(self, images: Float[Tensor, "B 3 h w"]) -> Float[Tensor, "B rows columns C"]:
        colour = functional.avg_pool2d(images, self.patch).permute(0, 2, 3, 1)
        return torch.cat((self._inner(images.permute(0, 2, 3, 1)), colour), dim=3)


def with_colour(extractor: FeatureExtractor) -> FeatureExtractor:
    """Return the extractor with the mean red, green and blue of each patch as the last three features."""
    backbone, pca = WithColour(extractor.backbone), extractor.pca
    basis = np.zeros((backbone.channels, pca.components + 3), np.float32)
    basis[: pca.basis.shape[0], : pca.components] = pca.basis
    basis[-3:, -3:] = np.eye(3)
    extended = PrincipalComponents(
        mean=np.append(pca.mean, np.zeros(3)).astype(np.float32),
        basis=basis,
        variance=np.append(pca.variance, np.ones(3)).astype(np.float32),
        total_variance=pca.total_variance + 3,
        backbone=backbone.name,
        fingerprint=backbone.fingerprint,
    )
    return FeatureExtractor(backbone, extended)


def see_cells(log: Path, rig: Rig, extractor: FeatureExtractor) -> SeenCells:
    """Play a simulated drive back, and read the truth at the cells that its wheels touched.

    Raises:
        LogError: the log has no cameras, LiDARs or ground truth, or they are damaged.
    """
    truth = read_truth_map(log)
    rows, sensors = extract_rows(read_drive(log, rig)), open_sensors(open_log(log), rig)
    settings = MapperSettings()
    seen = with_visual_features(rows, sensors, rig, with_colour(extractor), settings).cells
    assert seen is not None
    xy = rows.state[:, :2].astype(np.float64) + rows.origin
    wheels = wheel_positions(xy, rows.state[:, 2].astype(np.float64), rig.wheel_positions()).reshape(-1, 2)
    cell, contact = np.unique(seen.index, return_index=True)
    contact = contact[cell >= 0]
    size = settings.map.voxels.size
    centre = np.round(wheels[contact] / size) * size
    layers = np.stack([truth.layers[name] for name in (*GROUND_PROPERTIES, *GROUND)], axis=-1)
    there = read_grid(layers, truth.origin, truth.resolution, centre)
    return SeenCells(
        features=seen.features[..., :-3],
        colour=seen.features[..., -3:],
        valid=seen.valid,
        properties=there[:, : len(GROUND_PROPERTIES)],
        ground=there[:, len(GROUND_PROPERTIES) :],
        row=contact // len(WHEELS),
    )
