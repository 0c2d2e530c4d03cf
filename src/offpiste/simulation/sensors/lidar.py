"""A spinning LiDAR whose rings fire together, column by column, while the vehicle moves."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from offpiste.native.library import entry
from offpiste.simulation.rendering.scene import BLOCK, Scene, body_hits
from offpiste.simulation.sample import Motion, Pose

_turn_rays = entry("turn_rays", int, int, "f8", "f8", "f4")
_reflect = entry("reflect", int, int, int, int, "f4", "f4", "f4", "i1", "f4", "f4", "f4", "i1")
_measure_points = entry(
    "measure_points", int, float, float, float, float, "f8", "f4", "f4", "f8", "f8", "i4", "f4", returns=int
)

REFLECTIVITY = np.array([0.0, 0.30, 0.25, 0.50, 0.45, 0.50, 0.35], np.float32)
"""Reflectivity of `SURFACES` near 900 nm; soil 0.2 to 0.4, green leaves about 0.5 (ASTER library, rounded)."""


@dataclass(frozen=True)
class LidarSettings:
    """Settings of one LiDAR; the defaults follow the data sheet of an Ouster OS1-64 (1024 x 10)."""

    name: str  # name of the frame and the topic
    body_from_sensor: Pose  # pose (x forward, y left, z up)
    rate: float = 10.0  # revolutions [1/s]
    rings: int = 64  # rays from top to bottom
    columns: int = 1024  # rays per ring and revolution
    highest: float = np.deg2rad(12.0)  # elevation of the first ring [rad]
    lowest: float = np.deg2rad(-33.0)  # elevation of the last ring [rad]
    min_range: float = 0.5  # [m]
    max_range: float = 80.0  # [m]
    range_noise: float = 0.02  # standard deviation [m]
    dropout: float = 0.01  # share of rays lost at random
    # Share of rays lost at `max_range` on a surface of reflectivity 0.1 facing the LiDAR; it determines how returns
    # fade with range and grazing angle
    lost: float = 0.5


@dataclass(frozen=True)
class Scan:
    """Points of one revolution, each in the LiDAR's frame at its time of measurement."""

    points: Float[np.ndarray, "n 3"]  # [m]
    intensity: Float[np.ndarray, " n"]  # reflectivity times the cosine of incidence
    ring: Int[np.ndarray, " n"]  # number of the ring, 0 is the highest
    time: Float[np.ndarray, " n"]  # time since the start of the revolution [s]
    surface: Int[np.ndarray, " n"]  # index into `SURFACES`; ground truth, not recorded


class Lidar:
    """A LiDAR on a vehicle, with its rays and their hits on the vehicle itself."""

    def __init__(self, settings: LidarSettings) -> None:
        self.settings = settings
        rings, columns = settings.rings, settings.columns
        elevation = np.linspace(settings.highest, settings.lowest, rings)
        azimuth = np.pi - 2 * np.pi * np.arange(columns) / columns  # clockwise from behind, seam at the back
        horizontal = np.stack((np.cos(azimuth), np.sin(azimuth), np.zeros(columns)), axis=1)[:, None]
        upright = np.array([0.0, 0.0, 1.0])
        # [columns, rings, 3]
        self._ray = np.cos(elevation)[:, None] * horizontal + np.sin(elevation)[:, None] * upright
        self._time = np.arange(columns) / columns / settings.rate
        mount = settings.body_from_sensor
        # Cast ring by ring: neighbours in a ring hit close to each other, which halves the time of their packets.
        self._origin = mount.position
        self._ray_body = np.ascontiguousarray((self._ray @ mount.rotation.T).transpose(1, 0, 2))
        rays = self._ray_body.reshape(-1, 3)
        own = body_hits(mount.position, rays)
        self._own = replace(own, distance=np.minimum(own.distance, np.float32(settings.max_range)))

    def scan(self, scene: Scene, motion: Motion, start: float, rng: np.random.Generator) -> Scan:
        """Return the points of a revolution, from the motion `world_from_body` and the time of the first column [s]."""
        distance, echo, surface = self._echoes(scene, *motion.at(start + self._time))
        n, rings, s = len(distance), self.settings.rings, self.settings
        random, noise = rng.random(n), s.range_noise * rng.standard_normal(n)
        returned, points = np.empty(n, np.int32), np.empty((n, 3), np.float32)
        limits = (s.min_range, s.max_range, s.dropout, s.lost)
        found = _measure_points(n, *limits, self._ray, distance, echo, random, noise, returned, points)
        returned = returned[:found].copy()
        return Scan(
            points=points[:found].copy(),
            intensity=(echo[returned] * rng.uniform(0.9, 1.1, len(returned))).astype(np.float32),
            ring=returned % np.int32(rings),
            time=np.repeat(self._time.astype(np.float32), rings)[returned],
            surface=surface[returned],
        )

    def _echoes(
        self, scene: Scene, position: Float[np.ndarray, "columns 3"], rotation: Float[np.ndarray, "columns 3 3"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """Return distance, reflectivity times the cosine of incidence, and surface of each hit, column by column."""
        rings, columns = self._ray_body.shape[:2]
        origin = (position + rotation @ self._origin).astype(np.float32)
        distance, echo = (np.empty((columns, rings), np.float32) for _ in range(2))
        surface = np.empty((columns, rings), np.int8)

        def block(first: int, last: int) -> None:
            rays = np.empty(((last - first) * columns, 3), np.float32)
            _turn_rays(last - first, columns, rotation, self._ray_body[first:last], rays)
            own = self._own.part(slice(first * columns, last * columns))
            hits = scene.cast(np.tile(origin, (last - first, 1)), rays, own)
            found = (hits.distance, hits.surface, hits.normal)
            _reflect(first, last, rings, columns, REFLECTIVITY, rays, *found, distance, echo, surface)

        scene.spread(rings, block, size=max(BLOCK // columns, 1))
        return distance.ravel(), echo.ravel(), surface.ravel()
