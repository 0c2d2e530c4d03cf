"""A driver that looks for trouble: follows trails, cuts across open ground, and drives to the point of slip.

It knows the country (slopes, trees, trails) but not the grip. Ten times a second it picks the arc that leads best to a
point ahead on its route; speed follows a mood that wanders, with bursts of throttle, brake and steering on top.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from offpiste.conventions import DT, GRAVITY
from offpiste.geometry import yaw_from_quaternion
from offpiste.simulation.route import Route
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.surface import read_grid
from offpiste.simulation.world import World


@dataclass(frozen=True)
class DriverSettings:
    """How somebody drives.

    Attributes:
        median_speed: that the mood wanders around [m/s].
        speed_spread: standard deviation of the logarithm of the speed in mind.
        top_speed: [m/s].
        cornering: lateral acceleration that is accepted, lowest and highest over time [m/s^2].
        burst_every: mean time between bursts [s].
        off_trail: share of the way that leads across open ground.
        steepest: slope that is avoided [rad].
        bump: vertical acceleration that is accepted [m/s^2].
        patience: a vehicle that has not moved for so long is stuck [s].
    """

    median_speed: float = 5.2
    speed_spread: float = 0.5
    top_speed: float = 12.0
    cornering: tuple[float, float] = (2.5, 6.0)
    burst_every: float = 5.0
    off_trail: float = 0.35
    steepest: float = 0.24
    bump: float = 5.0
    patience: float = 6.0


_CURVATURES = np.linspace(-0.22, 0.22, 23)
"""Of the arcs to choose from [1/m]."""

_SEEN = np.linspace(0.1, 1.0, 14)
"""Shares of an arc at which it is looked at."""


class Driver:
    """Commands for a vehicle in a world.

    Args:
        wheelbase: [m].
        max_steer: road-wheel angle at a steering command of 1 [rad].
        rng: of the route, the mood and the bursts.
    """

    def __init__(
        self,
        world: World,
        *,
        wheelbase: float,
        max_steer: float,
        rng: np.random.Generator,
        settings: DriverSettings | None = None,
    ) -> None:
        self._world, self._wheelbase, self._max_steer = world, wheelbase, max_steer
        self._settings = settings or DriverSettings()
        self._rng = rng
        self.route = Route(world, rng, off_trail=self._settings.off_trail)
        self._trees = cKDTree(world.trees.foot[:, :2]) if len(world.trees.foot) else None
        self._mood = rng.standard_normal(3)
        self._burst, self._burst_left, self._next_burst = "", 0.0, rng.exponential(self._settings.burst_every)
        self._curvature, self._ticks, self._still = 0.0, 0, 0.0
        self._limit = self._settings.top_speed

    @property
    def stuck(self) -> bool:
        """Whether it has given up: full throttle has not moved the vehicle."""
        return self._still > self._settings.patience

    def start(self) -> tuple[float, float, float, float]:
        """Where a drive begins: x, y [m], yaw [rad] along a trail, speed [m/s]."""
        x, y, yaw = self.route.start()
        return x, y, yaw, float(self._rng.uniform(2.0, 6.0))

    def command(self, sample: VehicleSample) -> Float[np.ndarray, " 3"]:
        """Throttle, brake and steering for the next `conventions.DT`."""
        yaw = float(yaw_from_quaternion(sample.orientation[None])[0])
        heading = np.array([np.cos(yaw), np.sin(yaw)])
        speed = float(sample.velocity[:2] @ heading)
        self._wander()
        if self._ticks % 5 == 0:
            self._curvature, self._limit = self._choose_arc(sample.position[:2], yaw, max(speed, 0.0))
        self._ticks += 1
        self._still = self._still + DT if speed < 0.3 else 0.0
        throttle, brake = self._pedals(speed)
        # Spinning wheels are heard, and dig themselves in.
        spin = float(sample.wheel_speed.mean()) - max(speed, 0.0)
        throttle *= float(np.clip(1.0 - 0.5 * (spin - 0.8 - 0.2 * max(speed, 0.0)), 0.08, 1))
        return np.array([throttle, brake, self._steering(speed, float(sample.angular_velocity[2]))])

    def _wander(self) -> None:
        """Mood: speed over 4 s, cornering over 6 s, free steering over 0.7 s (Gauss-Markov); and bursts."""
        keep = np.exp(-DT / np.array([4.0, 6.0, 0.7]))
        self._mood = keep * self._mood + np.sqrt(1 - keep**2) * self._rng.standard_normal(3)
        self._burst_left -= DT
        self._next_burst -= DT
        if self._burst_left <= 0:
            self._burst = ""
        if self._next_burst <= 0:
            self._burst = str(self._rng.choice(["throttle", "brake", "coast", "swerve"]))
            self._burst_left = self._rng.uniform(0.4, 1.6)
            self._next_burst = self._rng.exponential(self._settings.burst_every) + self._burst_left

    def _choose_arc(self, xy: Float[np.ndarray, " 2"], yaw: float, speed: float) -> tuple[float, float]:
        """The arc that ends nearest to the goal, clear of trees, steep ground and the border: curvature, top speed."""
        length = float(np.clip(1.6 * speed, 5.0, 14.0))
        goal = self.route.ahead(xy, length)
        s = length * _SEEN[None]
        turn = _CURVATURES[:, None] * s
        # Chord of an arc: s sinc(turn/2) long, turned by half of it.
        chord = s * np.sinc(turn / (2 * np.pi))
        points = xy + chord[..., None] * np.stack((np.cos(yaw + turn / 2), np.sin(yaw + turn / 2)), axis=-1)
        cost = np.hypot(*np.moveaxis(points[:, -1] - goal, -1, 0)) + 6.0 * np.abs(_CURVATURES - self._curvature)
        danger, limits = self._danger(points)
        best = int(np.argmin(cost + danger))
        return float(_CURVATURES[best]), float(limits[best])

    def _danger(self, points: Float[np.ndarray, "A P 2"]) -> tuple[Float[np.ndarray, " A"], Float[np.ndarray, " A"]]:
        """What arcs through these points risk, in metres of detour, and how fast they can be driven [m/s]."""
        world = self._world
        flat = points.reshape(-1, 2)
        risk = np.zeros(len(flat))
        if self._trees is not None:
            clearance, nearest = self._trees.query(flat)
            clearance = clearance - world.trees.trunk_radius[np.minimum(nearest, len(world.trees.foot) - 1)]
            risk += 40.0 * (clearance < 1.6) + 4.0 * np.clip(3.0 - clearance, 0, None)
        heights = read_grid(world.elevation, world.origin, world.resolution, flat).reshape(points.shape[:2])
        run = np.hypot(*np.moveaxis(np.diff(points, axis=1), -1, 0))
        rise = np.diff(heights, axis=1) / run
        across = np.hypot(rise, self._side_slope(flat).reshape(points.shape[:2])[:, 1:])
        steep = np.clip(np.arctan(across) - self._settings.steepest, 0, None)
        risk = risk.reshape(points.shape[:2]).max(axis=1) + 120.0 * steep.max(axis=1)
        ny, nx = world.elevation.shape
        low = np.array(world.origin) + 8
        high = np.array(world.origin) + np.array([nx - 1, ny - 1]) * world.resolution - 8
        outside = np.clip(np.maximum(low - points, points - high), 0, None).max(axis=(1, 2))
        bend = np.abs(np.diff(rise, axis=1) / run[:, 1:]).max(axis=1)
        limit = np.sqrt(self._settings.bump / np.maximum(bend, 1e-3)) - 8.0 * np.clip(across.max(axis=1) - 0.2, 0, None)
        return risk + 10 * outside, np.maximum(limit, 2.5)

    def _side_slope(self, flat: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Steepness of the ground between two points 1.5 m apart, whichever of the two axes is steeper."""
        world, step = self._world, 0.75
        slopes = [
            read_grid(world.elevation, world.origin, world.resolution, flat + offset)
            - read_grid(world.elevation, world.origin, world.resolution, flat - offset)
            for offset in (np.array([step, 0.0]), np.array([0.0, step]))
        ]
        return np.asarray(np.abs(slopes).max(axis=0) / (2 * step))

    def _pedals(self, speed: float) -> tuple[float, float]:
        settings = self._settings
        gentle, hard = settings.cornering
        lateral = gentle + (hard - gentle) * float(np.clip(0.5 + 0.4 * self._mood[1], 0, 1))
        wanted = settings.median_speed * np.exp(settings.speed_spread * self._mood[0])
        wanted = min(wanted, settings.top_speed, self._limit, np.sqrt(lateral / max(abs(self._curvature), 1e-3)))
        wanted = max(wanted, 1.5)
        if self._still > 1.0:
            return 1.0, 0.0
        if self._burst == "throttle" and speed < min(settings.top_speed, self._limit):
            return 1.0, 0.0
        if self._burst == "brake" and speed > 2.0:
            return 0.0, float(np.clip(0.55 + 0.4 * self._mood[2], 0.2, 1.0))
        if self._burst == "coast" and speed > 2.0:
            return 0.0, 0.0
        lack = wanted - speed
        throttle = float(np.clip(0.18 + 0.22 * lack, 0, 1)) if lack > -0.6 else 0.0
        return throttle, float(np.clip(-0.18 * (lack + 1.0), 0, 1))

    def _steering(self, speed: float, yaw_rate: float) -> float:
        """The arc's curvature, corrected by how fast the vehicle really turns, and some play."""
        curvature = self._curvature + 0.02 * self._mood[2]
        angle = np.arctan(self._wheelbase * curvature) + 0.12 * (curvature * speed - yaw_rate)
        if self._burst == "swerve" and speed < 9.0:
            angle += 0.5 * self._max_steer * np.sign(self._mood[1]) * np.sin(4.0 * self._burst_left)
        # Beyond this, on any ground, more steering only rolls the vehicle over.
        most = np.arctan(self._wheelbase * 1.1 * GRAVITY / max(speed, 1.0) ** 2)
        return float(np.clip(np.clip(angle, -most, most) / self._max_steer, -1, 1))
