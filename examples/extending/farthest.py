"""A fusion rule from outside the package: a voxel keeps the observation taken from farthest away.

It shows what a map from far off looks like beside the usual one, which keeps the closest observation. With this module
named in `OFFPISTE_EXTENSIONS`, or imported, maps take the rule by its name:

    MapSettings(VoxelSettings(rule="farthest"))
"""

from offpiste.mapping.voxel_map import FUSION_RULES


@FUSION_RULES.register("farthest")
def farthest(distance: float, held_distance: float, count: int) -> bool:
    """Keep the observation from farthest, of equally far ones the first."""
    return distance > held_distance
