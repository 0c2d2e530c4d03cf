"""A spinning LiDAR whose rings fire together, column by column, while the vehicle moves."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from offpiste.native.compilation import RAYS
from offpiste.simulation.rendering.scene import BLOCK, Scene, body_hits
from offpiste.simulation.sample import Motion, Pose

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
        returned = np.empty(n, np.int32)
        limits = (np.float32(limit) for limit in (s.min_range, s.max_range, s.dropout, s.lost))
        returned = returned[: _returned(*limits, distance, echo, random, returned)]
        points = np.empty((len(returned), 3), np.float32)
        _place(self._ray.reshape(-1, 3), distance, noise, returned, points)
        return Scan(
            points=points,
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
            _turn(rotation, self._ray_body[first:last], rays)
            own = self._own.part(slice(first * columns, last * columns))
            hits = scene.cast(np.tile(origin, (last - first, 1)), rays, own)
            _reflect(REFLECTIVITY, hits.distance, hits.surface, hits.normal, rays, first, distance, echo, surface)

        scene.spread(rings, block, size=max(BLOCK // columns, 1))
        return distance.ravel(), echo.ravel(), surface.ravel()


@RAYS.entry
def _turn(rotation, ray_body, ray_world):  # type: ignore[no-untyped-def]
    """Rotate rays [rings, columns, 3] by the rotation of each column, ring by ring."""
    rings, columns = ray_body.shape[:2]
    for r in range(rings):
        for c in range(columns):
            x, y, z = ray_body[r, c, 0], ray_body[r, c, 1], ray_body[r, c, 2]
            for i in range(3):
                ray_world[r * columns + c, i] = rotation[c, i, 0] * x + rotation[c, i, 1] * y + rotation[c, i, 2] * z


@RAYS.entry
def _reflect(reflectivity, distances, surfaces, normal, ray, first, distance, echo, surface):  # type: ignore[no-untyped-def]
    """Sort hits of the rings from `first` on by column, and compute reflectivity times the cosine of incidence."""
    columns = len(distance)
    for n in range(len(ray)):
        c, r = n % columns, first + n // columns
        facing = normal[n, 0] * ray[n, 0] + normal[n, 1] * ray[n, 1] + normal[n, 2] * ray[n, 2]
        distance[c, r], surface[c, r] = distances[n], surfaces[n]
        echo[c, r] = reflectivity[surfaces[n]] * abs(facing)


@RAYS.entry
def _returned(nearest, farthest, dropout, lost, distance, echo, random, returned):  # type: ignore[no-untyped-def]
    """Write the indices of rays that return a point, given uniform random numbers; returns their number.

    The share lost is `dropout`, and more as the echo fades with the square of the range.
    """
    count, one = 0, np.float32(1)
    for n in range(len(distance)):
        if not (nearest < distance[n] < farthest) or random[n] <= dropout:
            continue
        range_ratio = farthest / distance[n]
        strength = echo[n] / np.float32(0.1) * (range_ratio * range_ratio)
        if random[n] > dropout + (one - dropout) * lost ** max(strength, np.float32(0)):
            returned[count] = n
            count += 1
    return count


@RAYS.entry
def _place(ray, distance, noise, returned, points):  # type: ignore[no-untyped-def]
    """Compute the measured points."""
    for k in range(len(returned)):
        n = returned[k]
        measured = distance[n] + noise[n]
        for axis in range(3):
            points[k, axis] = ray[n, axis] * measured
