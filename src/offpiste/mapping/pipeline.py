"""Mapping pipeline from scans with features to map layers, identical on the vehicle and offline.

On the vehicle features are encoded before mapping, from 40 channels to 4; offline the map holds features, from which
the encoder is learned (paper, "Dataset Collection Pipeline").
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.mapping.free_space import FreeSpace, FreeSpaceSettings
from offpiste.mapping.ghosts import GhostFinder, GhostSettings
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.mapping.voxel_map import VoxelMap, VoxelSettings
from offpiste.mapping.voxels_to_layers import Flattener, FlattenSettings, MapCells


@dataclass(frozen=True)
class FeatureCloud:
    """Scan with image features at its points."""

    points_world: Float[np.ndarray, "N 3"]  # float64 far from the world's origin [m]
    sensor_world: Float[np.ndarray, " 3"]  # position of the sensor [m]
    features: Float[np.ndarray, "N F"] | None = None  # None for a scan without an image
    has_feature: Bool[np.ndarray, " N"] | None = None  # mask of the points with features


@dataclass(frozen=True)
class MapSettings:
    """Settings of the voxel map and its layers; None disables the removal of ghosts or of moving objects' trails."""

    voxels: VoxelSettings = field(default_factory=VoxelSettings)
    flatten: FlattenSettings = field(default_factory=FlattenSettings)
    ghosts: GhostSettings | None = field(default_factory=GhostSettings)
    free_space: FreeSpaceSettings | None = field(default_factory=FreeSpaceSettings)


class MapPipeline:
    """Map of features or codes with some channels around a vehicle, built from its scans."""

    def __init__(self, channels: int, settings: MapSettings | None = None) -> None:
        settings = settings or MapSettings()
        self.voxel_map = VoxelMap(channels, settings.voxels)
        self._ghosts = None if settings.ghosts is None else GhostFinder(settings.ghosts)
        self._free_space = None if settings.free_space is None else FreeSpace(self.voxel_map, settings.free_space)
        self._flattener = Flattener(self.voxel_map, settings.flatten)

    def add(self, cloud: FeatureCloud, vehicle_world: Float[np.ndarray, " 3"]) -> Bool[np.ndarray, " N"]:
        """Move the map to the vehicle, insert a scan without its ghosts and return the mask of ghosts.

        Raises `ValueError` for a position that is not finite, and for another number of channels than the map's.
        """
        self.voxel_map.recentre(vehicle_world[:2], float(vehicle_world[2]))
        points, sensor, has_feature = cloud.points_world, cloud.sensor_world, cloud.has_feature
        if has_feature is None:
            has_feature = np.full(len(points), cloud.features is not None)
        away = (points - sensor).astype(np.float32)
        distance, ghosts = np.sqrt(np.einsum("ij,ij->i", away, away)), np.zeros(len(points), bool)
        if self._ghosts is not None:
            ghosts = self._ghosts.find(points, sensor)
            distance[ghosts] = np.inf  # ignored by the map
        self.voxel_map.insert(points, cloud.features, has_feature, distance)
        if self._free_space is not None:
            self._free_space.clear(points, sensor, ghosts)
        return ghosts

    def layers(self, out: TerrainLayers | None = None) -> TerrainLayers:
        """Return the current layers; `out` are layers of this pipeline to be overwritten."""
        return self._flattener.layers(out)

    def cells(self, rows: Int[np.ndarray, " K"], columns: Int[np.ndarray, " K"]) -> MapCells:
        """Return the values of `layers` at some cells only."""
        return self._flattener.cells(rows, columns)
