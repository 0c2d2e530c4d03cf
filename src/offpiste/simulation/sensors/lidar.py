"""A spinning LiDAR: all rings fire at once, column after column, while the vehicle moves."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from offpiste.compilation import RAYS
from offpiste.simulation.rendering.scene import Scene, body_hits, cast_rays, nearest
from offpiste.simulation.sample import Motion, Pose

REFLECTIVITY = np.array([0.0, 0.30, 0.25, 0.50, 0.45, 0.50, 0.35], np.float32)
"""Reflectivity of `SURFACES` near 900 nm [1]; soil 0.2 to 0.4, green leaves about 0.5 (ASTER library, rounded)."""


@dataclass(frozen=True)
class LidarSettings:
    """Settings of one LiDAR; the defaults follow the data sheet of an Ouster OS1-64 (1024 x 10).

    Attributes:
        name: name of the frame and the topic.
        body_from_lidar: x forward, y left, z up.
        rate: revolutions [1/s].
        rings, columns: rays per revolution.
        highest, lowest: elevation of the first and the last ring [rad].
        min_range, max_range: [m].
        range_noise: standard deviation [m].
        dropout: share of rays lost at random.
        lost: share of rays lost at the largest range on a surface of reflectivity 0.1 that faces the LiDAR; it sets how
            fast returns fade with range and grazing angle.
    """

    name: str
    body_from_lidar: Pose
    rate: float = 10.0
    rings: int = 64
    columns: int = 1024
    highest: float = np.deg2rad(12.0)
    lowest: float = np.deg2rad(-33.0)
    min_range: float = 0.5
    max_range: float = 80.0
    range_noise: float = 0.02
    dropout: float = 0.01
    lost: float = 0.5


@dataclass(frozen=True)
class Scan:
    """Points of one revolution, each in the LiDAR's frame at the moment it was measured.

    Attributes:
        points: [m].
        intensity: reflectivity times the cosine of incidence [1].
        ring: number of the ring, 0 is the highest.
        time: since the start of the revolution [s].
        surface: index into `SURFACES`; ground truth, not recorded.
    """

    points: Float[np.ndarray, "n 3"]
    intensity: Float[np.ndarray, " n"]
    ring: Int[np.ndarray, " n"]
    time: Float[np.ndarray, " n"]
    surface: Int[np.ndarray, " n"]


class Lidar:
    """A LiDAR on its vehicle, with its rays and those of them that end on the vehicle itself."""

    def __init__(self, settings: LidarSettings) -> None:
        self.settings = settings
        rings, columns = settings.rings, settings.columns
        elevation = np.linspace(settings.highest, settings.lowest, rings)
        azimuth = np.pi - 2 * np.pi * np.arange(columns) / columns  # clockwise from behind, seam at the back
        horizontal = np.stack((np.cos(azimuth), np.sin(azimuth), np.zeros(columns)), axis=1)[:, None]
        upright = np.array([0.0, 0.0, 1.0])
        self._ray = (
            np.cos(elevation)[:, None] * horizontal + np.sin(elevation)[:, None] * upright
        )  # [columns, rings, 3]
        self._time = np.arange(columns) / columns / settings.rate
        mount = settings.body_from_lidar
        self._origin, self._ray_body = mount.position, self._ray @ mount.rotation.T
        rays = self._ray_body.reshape(-1, 3)
        self._own = body_hits(np.broadcast_to(mount.position, rays.shape), rays)

    def scan(self, scene: Scene, motion: Motion, start: float, rng: np.random.Generator) -> Scan:
        """Points of one revolution.

        Args:
            scene: in the world frame.
            motion: `world_from_body` during the revolution.
            start: time of the first column [s].
        """
        s, shape = self.settings, self._ray.shape[:2]
        position, rotation = motion.at(start + self._time)
        origin = position + rotation @ self._origin
        ray_world = np.empty((shape[0] * shape[1], 3), np.float32)
        _turn(rotation, self._ray_body, ray_world)
        hits = nearest(self._own, cast_rays(scene, np.repeat(origin.astype(np.float32), s.rings, axis=0), ray_world))
        echo = np.empty(len(ray_world), np.float32)
        _reflect(REFLECTIVITY, hits.surface, hits.normal, ray_world, echo)
        seen = (hits.distance > s.min_range) & (hits.distance < s.max_range)
        seen &= rng.random(len(echo)) > lost_share(s, hits.distance, echo)
        distance = hits.distance + s.range_noise * rng.standard_normal(len(echo))
        column, ring = np.unravel_index(np.flatnonzero(seen), shape)
        intensity = echo[seen] * rng.uniform(0.9, 1.1, len(column))
        return Scan(
            points=(self._ray[column, ring] * distance[seen, None]).astype(np.float32),
            intensity=intensity.astype(np.float32),
            ring=ring.astype(np.int32),
            time=self._time[column].astype(np.float32),
            surface=hits.surface[seen],
        )


@RAYS.entry
def _turn(rotation, ray_body, ray_world):  # type: ignore[no-untyped-def]
    """Rays [columns, rings, 3] turned by each column's rotation, one after the other."""
    columns, rings = ray_body.shape[:2]
    for c in range(columns):
        for r in range(rings):
            x, y, z = ray_body[c, r, 0], ray_body[c, r, 1], ray_body[c, r, 2]
            for i in range(3):
                ray_world[c * rings + r, i] = rotation[c, i, 0] * x + rotation[c, i, 1] * y + rotation[c, i, 2] * z


@RAYS.entry
def _reflect(reflectivity, surface, normal, ray, echo):  # type: ignore[no-untyped-def]
    """Reflectivity times the cosine of incidence."""
    for n in range(len(echo)):
        facing = normal[n, 0] * ray[n, 0] + normal[n, 1] * ray[n, 1] + normal[n, 2] * ray[n, 2]
        echo[n] = reflectivity[surface[n]] * abs(facing)


def lost_share(
    settings: LidarSettings, distance: Float[np.ndarray, " n"], echo: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Probability that a ray returns no point: `dropout`, and more as the echo fades with the square of the range.

    Args:
        echo: reflectivity times the cosine of incidence [1].
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        strength = echo / 0.1 * (settings.max_range / distance) ** 2  # 1 where `lost` holds
        faded = settings.lost ** np.maximum(strength, 0.0)
    return settings.dropout + (1 - settings.dropout) * faded
