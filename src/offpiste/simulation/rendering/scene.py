"""Scenes for cameras and LiDARs: meshes of a world and of the vehicle itself, and ray casting."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import resources
from itertools import pairwise
from typing import Final

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.native.library import entry
from offpiste.simulation.rendering.embree import Mesh, RayCaster
from offpiste.simulation.world.grids import read_grid
from offpiste.simulation.world.world import Bushes, Trees, World

_identify_hits = entry("identify_hits", int, "i4", "i4", "f4", "i1", "i8", "i4", "i1", "i4", "f4")

BLOCK = 65536
"""Rays in one block, about 5 MB; large enough that threads seldom wait for the interpreter."""
SURFACES = ("sky", "ground", "trunk", "crown", "bush", "grass", "body")
"""Surfaces that a ray can hit; "sky" if it hits nothing."""

LEAVES, BLADES = 400_000, 600_000
"""Total number of triangles of all crowns, and of all bushes; largest number of blades, which are then wider."""
BLADES_PER_AREA = 40.0
"""Blades per area in tall grass [1/m^2]."""
BLADE_WIDTH = 0.03
"""Width of a blade, which represents a small tuft [m]: a level ray travels about 2 m through grass, a steep one hits a
blade in one of ten cases."""


class Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Box of the vehicle's body (body.toml)."""

    low: tuple[float, float, float]  # lowest corner in the body frame [m]
    high: tuple[float, float, float]  # highest corner [m]
    paint: tuple[float, float, float] = (0.03, 0.03, 0.033)  # linear RGB; black plastic by default
    shadow: bool = False  # whether it casts a shadow on the ground


BODY: Final = msgspec.toml.decode((resources.files(__package__) / "body.toml").read_bytes(), type=dict[str, Part])
"""Parts of the vehicle by name."""


def ground_mesh(world: World) -> Mesh:
    """Return one quadrilateral per cell of the heightfield; all normals point up."""
    ny, nx = world.elevation.shape
    vertices = np.empty((ny, nx, 3), np.float32)
    vertices[..., 0] = world.origin[0] + world.resolution * np.arange(nx)
    vertices[..., 1] = world.origin[1] + world.resolution * np.arange(ny)[:, None]
    vertices[..., 2] = world.elevation
    node = np.arange(ny * nx, dtype=np.int32).reshape(ny, nx)
    a, b, c, d = node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]
    faces = np.stack((b, c, d, a), axis=-1).reshape(-1, 4)
    return Mesh("ground", vertices.reshape(-1, 3), faces, np.zeros(len(faces), np.int32))


def trunk_mesh(trees: Trees) -> Mesh:
    """Return tapered prisms from below the ground to three quarters of the tree's height."""
    n, sides = len(trees.height), 7
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
    """Return single triangles in an ellipsoid from a third of the height to the top."""
    radius = np.stack((trees.crown_radius, trees.crown_radius, 0.36 * trees.height), axis=1)
    centre = trees.foot + np.array([0.0, 0.0, 0.66]) * trees.height[:, None]
    return _leaves("crown", centre, radius, (30, 1500), 8.0, rng)


def bush_mesh(bushes: Bushes, rng: np.random.Generator) -> Mesh:
    """Return single triangles in an ellipsoid on the ground."""
    radius = np.stack((bushes.radius, bushes.radius, 0.5 * bushes.height), axis=1)
    centre = bushes.foot + np.array([0.0, 0.0, 0.5]) * bushes.height[:, None]
    return _leaves("bush", centre, radius, (20, 400), 6.0, rng)


def grass_mesh(world: World, rng: np.random.Generator) -> Mesh:
    """Return bent blades where `grass_height` is positive, which hide the ground from afar but not from above."""
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
    """Return axis-aligned boxes, given by their lowest and highest corners [m]."""
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
    per_plant_limits: tuple[int, int],
    dense: float,
    rng: np.random.Generator,
) -> Mesh:
    """Return random triangles in ellipsoids, denser near the hull; `dense`: about total area over the plant's area."""
    n = len(centre)
    per_plant = int(np.clip(LEAVES / max(n, 1), *per_plant_limits))
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


@dataclass(frozen=True)
class Hits:
    """First hits of rays."""

    distance: Float[np.ndarray, " n"]  # in lengths of the direction; infinite without a hit
    surface: Int[np.ndarray, " n"]  # index into `SURFACES`
    item: Int[np.ndarray, " n"]  # number of the plant, blade or box; 0 on the ground, -1 without a hit
    normal: Float[np.ndarray, "n 3"]  # unit normal towards the origin of the ray; zero without a hit

    @classmethod
    def none(cls, n: int) -> "Hits":
        """Return rays without hits."""
        distance, surface, item = np.full(n, np.inf, np.float32), np.zeros(n, np.int8), np.full(n, -1, np.int32)
        return cls(distance, surface, item, np.zeros((n, 3), np.float32))

    def part(self, rays: slice) -> "Hits":
        """Return a view of the hits of some rays."""
        return Hits(*(values[rays] for values in vars(self).values()))

    def copy(self) -> "Hits":
        """Return a copy."""
        return Hits(*(values.copy() for values in vars(self).values()))


class Scene:
    """Meshes in one frame, prepared for ray casting in a number of threads."""

    def __init__(self, parts: Sequence[Mesh], *, threads: int = 2) -> None:
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="offpiste-rays")
        parts = [part for part in parts if len(part.faces)]
        self._caster = RayCaster(parts)
        self._surfaces = np.array([SURFACES.index(part.surface) for part in parts], np.int8)
        self._first = np.cumsum([0, *(len(part.item) for part in parts)])
        self._items = np.concatenate([np.zeros(0, np.int32), *(part.item for part in parts)])

    def spread(self, rays: int, block: Callable[[int, int], None], *, size: int = BLOCK) -> None:
        """Call `block(first, last)` on parts of the rays in several threads."""
        cuts = [*range(0, rays, size), rays]
        for _ in self._pool.map(lambda part: block(*part), pairwise(cuts)):
            pass

    def cast(
        self, origins: Float[np.ndarray, "m 3"], directions: Float[np.ndarray, "n 3"], nearer: Hits | None = None
    ) -> Hits:
        """Return the first hit of each ray, computed in the calling thread.

        Args:
            origins: origin of each ray, or of all rays.
            nearer: other hits of the same rays, kept where they are nearer.
        """
        directions = _single(directions)
        hits = Hits.none(len(directions)) if nearer is None else nearer.copy()
        part, face = np.empty((2, len(directions)), np.int32)
        self._caster.intersect(_single(origins), directions, hits.distance, part, face, hits.normal)
        tables = self._surfaces, self._first, self._items
        _identify_hits(len(directions), part, face, directions, *tables, hits.surface, hits.item, hits.normal)
        return hits

    def occluded(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Return whether each ray hits anything."""
        blocked = np.zeros(len(directions), bool)

        def block(first: int, last: int) -> None:
            rays = slice(first, last)
            blocked[rays] = self._caster.occluded(_single(origins[rays]), _single(directions[rays]))

        self.spread(len(directions), block)
        return blocked


def world_scene(world: World, *, threads: int = 2) -> Scene:
    """Build the scene of a world's ground and plants; takes about 1 s and 300 MB at 320 m and 0.25 m."""
    rng = np.random.default_rng([world.settings.seed, 3])
    plants = (trunk_mesh(world.trees), crown_mesh(world.trees, rng), bush_mesh(world.bushes, rng))
    return Scene((ground_mesh(world), *plants, grass_mesh(world, rng)), threads=threads)


def _single(vectors: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(vectors, dtype=np.float32)


def body_hits(origin: Float[np.ndarray, " 3"], directions: Float[np.ndarray, "n 3"]) -> Hits:
    """Return the hits on the vehicle itself of rays in the body frame."""
    boxes = np.array([(part.low, part.high) for part in BODY.values()], np.float32)
    body = Scene([box_mesh(boxes)], threads=1)
    return body.cast(origin[None], directions)
