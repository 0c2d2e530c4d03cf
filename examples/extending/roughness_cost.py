"""A cost term and a map layer from outside the package: shaking, by the roughness of the ground under the wheels.

Each is declared once; the eager planner and the fused kernel read the declarations. Name this module in the
environment to plan with it:

    PYTHONPATH=examples/extending OFFPISTE_EXTENSIONS=roughness_cost python my_planner.py

`CostWeights(shaking=0.3)` weighs the term.
"""

import numpy as np

from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.planning.costs.declaration import cost_term
from offpiste.planning.costs.layers import CostLayer, cost_layer


@cost_layer(CostLayer("roughness", "m", "mean of wheels", outside=0.0))
def roughness_layer(ground: TerrainLayers) -> np.ndarray:
    """Roughness of cells [m]; 0 where unknown."""
    return np.nan_to_num(ground.roughness)


@cost_term("shaking", weight=0.2, unit="s/m^3")
def shaking_term(roughness: float, vx: float, weight: float) -> float:
    """Being shaken: weight roughness vx^2 [1/s]."""
    return weight * roughness * vx * vx
