"""What can be set about a map, with the values of the paper and of DESIGN.md as defaults."""

from dataclasses import dataclass, fields

from offpiste.errors import MapError
from offpiste.mapping.fusion import FUSION_RULES


@dataclass(frozen=True)
class VoxelSettings:
    """The voxel map.

    Attributes:
        size: of a voxel (paper, "Mapping of Visual Features": 0.2 m).
        reach: the map covers +-reach around the vehicle, both in x and in y (DESIGN.md: 60 m).
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
        _positive(self, "size", "reach", "height_reach", "capacity", "threads")
        if self.rule not in FUSION_RULES:
            rules = ", ".join(FUSION_RULES)
            raise MapError(f"fusion rule '{self.rule}' is unknown", where="map settings", how=f"use one of: {rules}")
        if not 1 <= self.half_cells <= 10_000:
            raise MapError(f"{self.half_cells} cells to each side", where="map settings", how="set 1 to 10000")

    @property
    def half_cells(self) -> int:
        """Cells from the vehicle to the map's border."""
        return round(self.reach / self.size)


@dataclass(frozen=True)
class FlattenSettings:
    """From the voxels to layers.

    Attributes:
        feature_height: a feature counts while the place where it was seen lies within this of the ground (DESIGN.md,
            "Map": 0.5 m) [m].
        fill_radius: gaps are filled from the nearest valid cell up to this far, centre to centre (paper: 0.4 m).
        vehicle_height: what is higher above the ground than this is driven under [m]; a side-by-side is 1.9 m high.
        overhang_radius: a column whose lowest voxel lies more than `vehicle_height` above the lowest one in the square
            of +-this around it is a branch, its ground unseen [m]. Ground of up to 54 degrees is never taken for one.
        plane_radius: normals and roughness come from the square of +-this around a cell [m].
    """

    feature_height: float = 0.5
    fill_radius: float = 0.4
    vehicle_height: float = 2.0
    overhang_radius: float = 1.0
    plane_radius: float = 0.4

    def __post_init__(self) -> None:
        _positive(self, "feature_height", "vehicle_height", "plane_radius")
        if not 0 <= self.fill_radius <= 5 or not 0 <= self.overhang_radius <= 5:
            raise MapError("radii are 0 to 5 m", where="map settings", how="mend fill_radius or overhang_radius")


def _positive(settings: VoxelSettings | FlattenSettings, *names: str) -> None:
    assert set(names) <= {field.name for field in fields(settings)}
    for name in names:
        value = getattr(settings, name)
        if not 0 < value < float("inf"):
            raise MapError(f"{name} is {value}", where="map settings", how="give a positive number")
