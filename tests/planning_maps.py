"""Small terrain maps and start states for tests of planning."""

import numpy as np
import torch

from offpiste.mapping.terrain_map import LAYERS, TerrainLayers, empty_layers
from offpiste.mapping.terrain_sampler import stack_maps
from offpiste.planning.costs.layers import Hazards, cost_map
from offpiste.planning.course import Course
from offpiste.planning.driving_cost import Situation

WHEELS = torch.tensor([[1.1, 0.8], [1.1, -0.8], [-1.1, 0.8], [-1.1, -0.8]])


def layers(cells=81, resolution=0.5, *, plane=(0.0, 0.0), channels=2, **changed):
    """A plane around the world's origin, all of it known."""
    at = resolution * (np.arange(cells) - cells // 2)
    x, y = np.meshgrid(at, at)
    normal = np.array([-plane[0], -plane[1], 1.0]) / np.sqrt(1 + plane[0] ** 2 + plane[1] ** 2)
    parts = {layer.name: np.zeros_like(getattr(empty_layers(cells, channels), layer.name)) for layer in LAYERS}
    parts["elevation"][:] = plane[0] * x + plane[1] * y
    parts["normal"][:], parts["slope"][:], parts["distance"][:] = normal, np.hypot(*plane), 1.0
    parts["known"][:], parts["observed"][:], parts["valid"][:] = True, True, True
    return TerrainLayers(np.full(2, at[0]), resolution, **{**parts, **changed})


def straight(speed=5.0):
    return Course(np.array([[-15.0, 0.0], [15.0, 0.0]]), np.full(2, speed))


def situation(ground=None, course=None, hazards=None, *, state=(0.0, 0, 0, 5, 0, 0), dtype=torch.float32):
    ground = layers() if ground is None else ground
    return Situation(
        ground=stack_maps([ground.terrain_map()]),
        costs=cost_map(ground, course or straight(), hazards or Hazards()),
        wheels=WHEELS.to(dtype),
        offset=torch.zeros(2, dtype=torch.float64),
        state=torch.tensor(state, dtype=dtype),
        control=torch.zeros(3, dtype=dtype),
    )
