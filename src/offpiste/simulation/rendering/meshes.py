"""Triangle meshes of a world's ground, trees, bushes and tall grass, and of the vehicle's boxes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from offpiste.simulation.world.surface import read_grid
from offpiste.simulation.world.world import Bushes, Trees, World

SURFACES = ("sky", "ground", "trunk", "crown", "bush", "grass", "body")
"""Surfaces that a ray can hit; "sky" means nothing."""

LEAVES = 400_000
"""Number of triangles of all crowns together, and again of all bushes."""

BLADES = 600_000
"""Largest number of triangles of tall grass; with fewer, blades are wider."""

BLADES_PER_AREA = 40.0
"""Blades per area where the grass is tall and their number is not limited [1/m^2]."""

BLADE_WIDTH = 0.03
"""Width of a blade, which represents a small tuft [m]. At 40 per square metre a level ray travels about 2 m through
grass, while a steep one hits a blade in one of ten cases."""


@dataclass(frozen=True)
class Mesh:
    """Triangles or quadrilaterals of one surface.

    Attributes:
        surface: name in `SURFACES`.
        vertices: [m].
        faces: indices of vertices; of quadrilaterals, 1 and 3 are the diagonal that they are folded along.
        item: the plant, or box, that each face belongs to.
    """

    surface: str
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f corners"]
    item: Int[np.ndarray, " f"]


def ground_mesh(world: World) -> Mesh:
    """Two triangles, as one quadrilateral, a cell of the heightfield; all normals point up."""
    ny, nx = world.elevation.shape
    vertices = np.empty((ny, nx, 3), np.float32)
    vertices[..., 0] = world.origin[0] + world.resolution * np.arange(nx)
    vertices[..., 1] = world.origin[1] + world.resolution * np.arange(ny)[:, None]
    vertices[..., 2] = world.elevation
    node = np.arange(ny * nx, dtype=np.int32).reshape(ny, nx)
    a, b, c, d = node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]
    faces = np.stack((b, c, d, a), axis=-1).reshape(-1, 4)
    return Mesh("ground", vertices.reshape(-1, 3), faces, np.zeros(len(faces), np.int32))


def trunk_mesh(trees: Trees, *, sides: int = 7) -> Mesh:
    """Tapered prisms from below the ground to three quarters of the height."""
    n = len(trees.height)
    angle = 2 * np.pi * np.arange(sides) / sides
    circle = np.stack((np.cos(angle), np.sin(angle), np.zeros(sides)), axis=1)
    up = np.array([0.0, 0.0, 1.0])
    foot = trees.foot[:, None] + circle * trees.trunk_radius[:, None, None] - 0.3 * up
    top = trees.foot[:, None] + circle * 0.4 * trees.trunk_radius[:, None, None]
    top = top + 0.75 * trees.height[:, None, None] * up
    k = np.arange(sides)
    following = (k + 1) % sides
    lower = np.stack((k, following, following + sides), axis=1)
    upper = np.stack((k, following + sides, k + sides), axis=1)
    faces = np.concatenate((lower, upper)) + 2 * sides * np.arange(n)[:, None, None]
    return _mesh("trunk", np.concatenate((foot, top), axis=1), faces.reshape(-1, 3), np.repeat(np.arange(n), 2 * sides))


def crown_mesh(trees: Trees, rng: np.random.Generator) -> Mesh:
    """Leaves as single triangles around an ellipsoid that reaches from a third of the height to the top."""
    n = len(trees.height)
    radius = np.stack((trees.crown_radius, trees.crown_radius, 0.36 * trees.height), axis=1)
    centre = trees.foot + np.array([0.0, 0.0, 0.66]) * trees.height[:, None]
    per_plant = int(np.clip(LEAVES / max(n, 1), 30, 1500))
    return _leaves("crown", centre, radius, per_plant, 8.0, rng)


def bush_mesh(bushes: Bushes, rng: np.random.Generator) -> Mesh:
    """Leaves as single triangles around an ellipsoid that stands on the ground."""
    n = len(bushes.height)
    radius = np.stack((bushes.radius, bushes.radius, 0.5 * bushes.height), axis=1)
    centre = bushes.foot + np.array([0.0, 0.0, 0.5]) * bushes.height[:, None]
    per_plant = int(np.clip(LEAVES / max(n, 1), 20, 400))
    return _leaves("bush", centre, radius, per_plant, 6.0, rng)


def grass_mesh(world: World, rng: np.random.Generator) -> Mesh:
    """Bent blades where `grass_height` is positive: they hide the ground from afar, not from above."""
    cell = world.resolution**2
    height = np.asarray(world.grass_height, float)
    density = BLADES_PER_AREA * cell * np.clip(height / 0.3, 0.0, 1.0)
    thinned = min(1.0, BLADES / max(density.sum(), 1.0))
    j, i = np.nonzero(height > 0.03)
    node = np.repeat(np.arange(len(j)), rng.poisson(density[j, i] * thinned))
    n = len(node)
    place = np.array(world.origin) + world.resolution * (
        np.stack((i[node], j[node]), axis=1) + rng.uniform(-0.5, 0.5, (n, 2))
    )
    ground = read_grid(world.elevation, world.origin, world.resolution, place)
    tall = height[j[node], i[node]] * rng.uniform(0.6, 1.15, n)
    direction, bend = rng.uniform(0, 2 * np.pi, n), rng.uniform(0.1, 0.6, n) * tall
    width = 0.5 * BLADE_WIDTH / np.sqrt(thinned) * rng.uniform(0.6, 1.4, n)
    across = np.stack((-np.sin(direction), np.cos(direction), np.zeros(n)), axis=1) * width[:, None]
    foot = np.column_stack((place, ground - 0.02))
    tip = foot + np.stack((np.cos(direction) * bend, np.sin(direction) * bend, tall), axis=1)
    vertices = np.stack((foot - across, foot + across, tip), axis=1)
    return _mesh("grass", vertices, np.arange(3 * n).reshape(-1, 3), np.arange(n))


def box_mesh(boxes: Float[np.ndarray, "n 2 3"]) -> Mesh:
    """Boxes along the axes, given by their lowest and highest corners [m]."""
    corner = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
    vertices = np.where(corner[None], boxes[:, 1:], boxes[:, :1])
    quads = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])
    faces = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    every = faces + 8 * np.arange(len(boxes))[:, None, None]
    return _mesh("body", vertices, every.reshape(-1, 3), np.repeat(np.arange(len(boxes)), len(faces)))


def _leaves(
    surface: str,
    centre: Float[np.ndarray, "n 3"],
    radius: Float[np.ndarray, "n 3"],
    per_plant: int,
    dense: float,
    rng: np.random.Generator,
) -> Mesh:
    """Triangles within ellipsoids, more of them near the hull.

    Args:
        dense: area of all leaves over that of the smallest circle around the plant, about.
    """
    n = len(centre)
    towards = rng.normal(size=(n, per_plant, 3))
    towards /= np.linalg.norm(towards, axis=2, keepdims=True)
    lumps = 1 + 0.15 * np.sin(5 * towards @ rng.normal(size=3))[..., None]
    depth = rng.uniform(0.25, 1.0, (n, per_plant, 1)) ** 0.5
    middle = centre[:, None] + towards * lumps * depth * radius[:, None]
    size = radius.min(axis=1)[:, None, None, None] * np.sqrt(dense / per_plant)
    shape = rng.normal(size=(n, per_plant, 3, 3)) * size
    vertices = middle[:, :, None] + shape - shape.mean(axis=2, keepdims=True)
    count = n * per_plant
    return _mesh(surface, vertices, np.arange(3 * count).reshape(-1, 3), np.repeat(np.arange(n), per_plant))


def _mesh(surface: str, vertices: np.ndarray, faces: np.ndarray, item: np.ndarray) -> Mesh:
    return Mesh(surface, vertices.reshape(-1, 3).astype(np.float32), faces.astype(np.int32), item.astype(np.int32))
