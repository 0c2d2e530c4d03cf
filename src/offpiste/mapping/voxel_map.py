"""A rolling voxel map around the vehicle that keeps, in each voxel, the observation taken from closest.

"To fuse multiple measurements, we retain the closest observation, allowing for instant updates and temporal stability
when moving away from a location" (paper, "Mapping of Visual Features").
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.errors import MapError
from offpiste.mapping.fusion import FUSION_RULES
from offpiste.mapping.voxel_kernels import (
    EVER,
    FEATURES,
    FREED,
    LEVELS,
    LOST,
    PARTS,
    Voxels,
    forget_left_behind,
    point_inserter,
)
from offpiste.native.compilation import spread_blocks


@dataclass(frozen=True)
class VoxelSettings:
    """Size and memory of the voxel map.

    Attributes:
        size: edge of a voxel (paper, "Mapping of Visual Features": 0.2 m).
        reach: the map covers +-reach around the vehicle, both in x and in y [m].
        height_reach: points further above or below the vehicle than this are not mapped: 27 degrees of slope at 60 m.
        rule: of `fusion.FUSION_RULES`; the paper keeps the closest observation.
        capacity: voxels that can be held; their memory is taken when they are first used (`VoxelMap`).
        threads: that insertion and flattening use; the map does not depend on it.
    """

    size: float = 0.2
    reach: float = 60.0
    height_reach: float = 30.0
    rule: str = "closest"
    capacity: int = 1_500_000
    threads: int = 2

    def __post_init__(self) -> None:
        check_positive(self, "size", "reach", "height_reach", "capacity", "threads")
        if self.rule not in FUSION_RULES:
            rules = ", ".join(FUSION_RULES)
            raise MapError(f"fusion rule '{self.rule}' is unknown", where="map settings", how=f"use one of: {rules}")
        if not 1 <= self.half_cells <= 10_000:
            raise MapError(f"{self.half_cells} cells to each side", where="map settings", how="set 1 to 10000")

    @property
    def half_cells(self) -> int:
        """Cells from the vehicle to the map's border."""
        return round(self.reach / self.size)


def check_positive(settings: object, *names: str) -> None:
    """Raise if one of these settings is no positive number.

    Raises:
        MapError: names the setting.
    """
    for name in names:
        value = getattr(settings, name)
        if not 0 < value < float("inf"):
            raise MapError(f"{name} is {value}", where="map settings", how="give a positive number")


class VoxelMap:
    """Voxels on a grid that stands still in the world and is never turned; the map is the part around the vehicle.

    A voxel has two memories: where it was hit, and what it looked like. A point without features, however close, leaves
    the features alone. Of equally close observations the first stays.

    A column keeps 31 levels from its lowest occupied voxel upwards, so that ground may lie anywhere: all that is lost
    is what hangs 6.2 m above it. Memory with voxels of 0.2 m and +-60 m: 53 MB for the columns, and for each voxel
    that was in use at one time 36 bytes without features, 68 with up to 8, 196 with up to 40: at most 350 MB with the
    1.5 million voxels (`VoxelSettings.capacity`) of 40 features.

    Attributes:
        settings: as given.
        channels: features of a voxel, F.
        low: integer coordinates x, y of the lowest cell; cell i covers [i, i + 1) voxel sizes.
        middle: height of the vehicle [m].
        changes: insertions and moves so far.
        voxels: the arrays themselves, for loops that read them.
    """

    def __init__(self, channels: int, settings: VoxelSettings | None = None) -> None:
        self.settings = settings or VoxelSettings()
        n, slots = 2 * self.settings.half_cells, -(-self.settings.capacity // PARTS)
        width = FEATURES if channels == 0 else -(-(FEATURES + channels) // 16) * 16
        self.low: Int[np.ndarray, " 2"] = np.full(2, -self.settings.half_cells, np.int64)
        self.middle = 0.0
        self.changes = 0
        self.channels = channels
        self.voxels = Voxels(
            heads=_aligned((n, n, 4), np.int32),
            changed=np.zeros((n, n), np.int32),
            slots=_aligned((n, n, LEVELS + 1), np.int32),
            seen=_aligned((PARTS * slots, width), np.float32),
            freed=np.empty((PARTS, slots), np.int32),
            counts=np.zeros((PARTS, 3), np.int64),
        )
        self._scale = 1.0 / self.settings.size
        self._insert_points = point_inserter(self.settings.rule)

    @property
    def cells(self) -> int:
        """Along each side of the map."""
        return 2 * self.settings.half_cells

    @property
    def origin(self) -> Float[np.ndarray, " 2"]:
        """x, y of the centre of the lowest cell in the world [m]."""
        return (self.low + 0.5) * self.settings.size

    @property
    def occupied(self) -> int:
        """Voxels held."""
        counts = self.voxels.counts
        return int((counts[:, EVER] - counts[:, FREED]).sum())

    @property
    def lost(self) -> int:
        """Observations that found no free voxel since the map was made; not 0: raise `capacity`."""
        return int(self.voxels.counts[:, LOST].sum())

    @property
    def nbytes(self) -> int:
        """Memory that is in use [bytes]; the system counts whole pages."""
        used = int(self.voxels.counts[:, EVER].sum())
        columns = self.voxels.heads.nbytes + self.voxels.changed.nbytes + self.voxels.slots.nbytes
        return columns + used * (self.voxels.seen.strides[0] + 4)

    def recentre(self, xy: Float[np.ndarray, " 2"], z: float) -> None:
        """Move the map in whole cells so that the vehicle is at its centre, within half a cell.

        Everything inside the new range is kept, what falls out of it is forgotten.

        Args:
            xy, z: of the vehicle in the world [m].

        Raises:
            ValueError: a place that is not finite, or beyond 1e8 cells from the world's origin.
        """
        cell = np.floor(np.asarray(xy, np.float64) * self._scale + 0.5)
        if not (np.abs([*cell, z * self._scale]) < 1e8).all():
            raise ValueError(f"a map cannot be centred at {xy}, {z} m")
        new = cell.astype(np.int64) - self.settings.half_cells
        moved = (new != self.low).any()
        if moved or round(z / self.settings.size) != round(self.middle / self.settings.size):
            self.changes += 1  # layers count heights from the vehicle's level
        if moved:
            forget_left_behind(self.low, new, self.changes, self.voxels)
        self.low, self.middle = new, float(z)

    def insert(
        self,
        points_world: Float[np.ndarray, "N 3"],
        features: Float[np.ndarray, "N F"] | None,
        has_feature: Bool[np.ndarray, " N"],
        distance: Float[np.ndarray, " N"],
    ) -> None:
        """Put observations in, in their order.

        Points outside the map, and points or distances that are not finite, are left out; features that are not finite
        count as none.

        Args:
            points_world: float64 far from the world's origin [m].
            features: None: these points have none.
            has_feature: which points have features.
            distance: from the sensor to each point [m].

        Raises:
            ValueError: features of another number of channels.
        """
        if features is None:
            features, has_feature = np.zeros((1, self.channels), np.float32), np.zeros(len(points_world), bool)
        elif features.shape[1] != self.channels:
            raise ValueError(f"the map has {self.channels} channels, these points {features.shape[1]}")
        self.changes += 1
        arguments = (
            np.ascontiguousarray(points_world, np.float64),
            np.ascontiguousarray(features, np.float32),
            np.ascontiguousarray(has_feature),
            np.ascontiguousarray(distance, np.float32),
            self.low,
            self.middle,
            self.settings.height_reach,
            self._scale,
            self.changes,
            self.voxels,
        )
        spread_blocks(self.settings.threads, PARTS, self._insert_points, *arguments)


def _aligned(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Zeros on cache lines; memory that was never written is none."""
    size = int(np.prod(shape)) * 4
    raw = np.zeros(size + 64, np.uint8)
    first = -raw.ctypes.data % 64
    return raw[first : first + size].view(dtype).reshape(shape)
