"""Fusion rules: how several observations of a voxel become one; each is declared once, for loops and for NumPy alike.

A rule says how much the new observation counts: 0 keeps what the voxel holds, 1 replaces it, anything between them is
the new one's share in a weighted mean. It is evaluated for the place of a hit and for its features, each with their own
distances; the first observation always stays. It is a function of plain scalars that Numba compiles into the loop over
points, and it must work on NumPy arrays too.
"""

from collections.abc import Callable
from typing import Any, Final

from offpiste.core.errors import MapError
from offpiste.core.registry import Registry

Scalar = Any
"""A number or an array."""

FusionRule = Callable[[Scalar, Scalar, Scalar], Scalar]
"""From the distance of the new observation [m], that of the held one [m] and the number of observations, the new one
counted, to the share of the new one."""

FUSION_RULES: Final[Registry[FusionRule]] = Registry("fusion rule", error=MapError)


@FUSION_RULES.register("closest")
def closest(distance: Scalar, held_distance: Scalar, count: Scalar) -> Scalar:
    """Keep the observation from closest, of equally close ones the first (paper, "Mapping of Visual Features")."""
    return distance < held_distance


@FUSION_RULES.register("latest")
def latest(distance: Scalar, held_distance: Scalar, count: Scalar) -> Scalar:
    """Keep the latest observation."""
    return 1.0


@FUSION_RULES.register("average")
def average(distance: Scalar, held_distance: Scalar, count: Scalar) -> Scalar:
    """The mean of all observations."""
    return 1.0 / count
