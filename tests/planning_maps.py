"""Small terrain maps and start states for tests of planning."""

import numpy as np
import torch

from offpiste.mapping.terrain_map import TerrainLayers
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
    shape = (cells, cells)
    parts = {
        "elevation": plane[0] * x + plane[1] * y,
        "normal": np.tile(normal.astype(np.float32), (*shape, 1)),
        "slope": np.full(shape, np.hypot(*plane), np.float32),
        "roughness": np.zeros(shape, np.float32),
        "obstacle_height": np.zeros(shape, np.float32),
        "features": np.zeros((*shape, channels), np.float32),
        "distance": np.ones(shape, np.float32),
        "known": np.ones(shape, bool),
        "observed": np.ones(shape, bool),
        "valid": np.ones(shape, bool),
    }
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
