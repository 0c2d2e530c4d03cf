"""A driver that looks for trouble: follows trails, cuts across open ground, and drives to the point of slip.

It knows the country (slopes, trees, trails: `arcs.Country`) but not the grip. Ten times a second it picks the arc that
leads best to a point ahead on its route; speed follows a mood that wanders, with bursts of throttle, brake and
steering, as fast as bends, bumps and banks in sight let it.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from offpiste.conventions import GRAVITY
from offpiste.simulation.driver.intent import Feeling, Mood
from offpiste.simulation.driver.lookahead import Country, Prospect, sample_terrain
from offpiste.simulation.driver.route import Route
from offpiste.simulation.driver.stuck import Stall
from offpiste.simulation.driver.traction_control import Foot
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.vehicle.parameters import VehicleParameters
from offpiste.simulation.world.world import World


@dataclass(frozen=True)
class DriverSettings:
    """How somebody drives.

    Attributes:
        median_speed: that the mood wanders around [m/s].
        speed_spread: standard deviation of the logarithm of the speed in mind.
        top_speed: [m/s].
        cornering: lateral acceleration that is accepted, lowest and highest over time [m/s^2].
        pause: mean time between ideas (`mood.Mood`) [s].
        off_trail: probability of leaving a trail across open ground at its next stretch.
        steepest: climb and lean that are avoided (rise over run).
        tilting: speed times lean that is accepted [m/s].
        bump: vertical acceleration that is accepted [m/s^2].
        standing_start: probability of starting at rest.
        patience: how long a stalled vehicle is worked free [s].
    """

    median_speed: float = 6.2
    speed_spread: float = 0.75
    top_speed: float = 12.0
    cornering: tuple[float, float] = (3.0, 7.0)
    pause: float = 3.5
    off_trail: float = 0.35
    steepest: float = 0.18
    tilting: float = 0.8
    bump: float = 6.0
    standing_start: float = 0.25
    timeouts: float = 15.0


_CURVATURES = np.linspace(-0.22, 0.22, 23)
"""Of the arcs to choose from [1/m]."""

_LOOK_EVERY = 5
"""Steps between two looks ahead."""

_LEVEL = 0.04
"""Climb on which a vehicle that stands can be expected to get away [1]."""

_TIPPING = 0.3
"""Roll beyond which nothing but staying upright counts (sine)."""

_ASIDE = 2
"""Arcs to either side onto which a vehicle may slide."""

_BRAKING = 3.5
"""Deceleration that is relied on before bends [m/s^2]."""

_MARGIN = 9.0
"""Distance that is kept from the world's border [m]."""


class Driver:
    """Commands for a vehicle in a world.

    Args:
        rng: of the route, the mood and the start.
    """

    def __init__(
        self,
        world: World,
        vehicle: VehicleParameters,
        rng: np.random.Generator,
        settings: DriverSettings | None = None,
    ) -> None:
        self._vehicle, self._settings = vehicle, settings or DriverSettings()
        self._country, self._rng = Country.of(world), rng
        self.route = Route(self._country, rng, off_trail=self._settings.off_trail)
        self._mood = Mood(rng, pause=self._settings.pause)
        self._stall = Stall(self._settings.timeouts)
        self._ticks, self._curvature, self._limit = 0, 0.0, self._settings.top_speed
        self._climb, self._lean = 0.0, 0.0
        self._foot = Foot()

    @property
    def stuck(self) -> bool:
        """Whether it has given up: nothing that it tried has moved the vehicle."""
        return self._stall.hopeless

    def start(self) -> tuple[float, float, float, float]:
        """Where a drive begins: x, y [m], yaw [rad] along a trail, speed [m/s]."""
        chance, speed = self._rng.random(), float(self._rng.uniform(2.0, 7.0))
        x, y, yaw, climb = self.route.start()
        return x, y, yaw, 0.0 if chance < self._settings.standing_start and climb < _LEVEL else speed

    def command(self, sample: VehicleSample) -> Float[np.ndarray, " 3"]:
        """Throttle, brake and steering for the next `conventions.DT`."""
        i, j, k, w = sample.orientation.tolist()
        yaw = math.atan2(2 * (i * j + k * w), 1 - 2 * (j * j + k * k))
        x, y, _ = sample.position.tolist()
        vx, vy, _ = sample.velocity.tolist()
        speed = vx * math.cos(yaw) + vy * math.sin(yaw)
        spin = sum(sample.wheel_speed.tolist()) / 4 - speed
        feeling = self._mood.advance()
        if self._ticks % _LOOK_EVERY == 0:
            self._look(x, y, yaw, max(speed, 0.0), feeling.cornering)
        self._ticks += 1
        # Who stops uphill may not get away again.
        stopping = feeling.idea == "stop" and self._climb < _LEVEL
        noticed = self._stall.noticed
        self._stall.advance(x, y, speed=speed, at_rest=stopping)
        leans_left = -2 * (j * k + i * w)
        if self._stall.noticed:
            if not noticed:
                self.route.rejoin(np.array((x, y)), np.array((math.cos(yaw), math.sin(yaw))))
            # With one wheel in the air, only a fast one passes torque on through a limited-slip differential.
            hanging = float(np.ptp(sample.wheel_speed)) > 2.0
            throttle, accepted, steer = self._stall.recover(speed, leans_left)
            return np.array((self._foot.press(throttle, spin, accepted + 12.0 * hanging), 0.0, steer))
        steer = self._steering(speed, float(sample.angular_velocity[2]), feeling)
        throttle, brake = (0.0, 0.3 + 0.5 * feeling.strength) if stopping else self._pedals(speed, feeling)
        accepted = 0.2 + 0.25 * max(speed, 0.0)
        if feeling.idea == "throttle" and self._climb < _LEVEL:
            accepted += 3.0 + 6.0 * feeling.strength
        tips_left = leans_left - 0.25 * float(sample.angular_velocity[0])
        if abs(tips_left) > _TIPPING and speed > 3.0:
            # About to roll over: into the fall, and off the pedals.
            throttle, brake = 0.3 * throttle, 0.0
            steer = _clip(steer + 5 * (tips_left - math.copysign(_TIPPING, tips_left)), -1.0, 1.0)
        return np.array((self._foot.press(throttle, spin, accepted), brake, steer))

    def _look(self, x: float, y: float, yaw: float, speed: float, cornering: float) -> None:
        """Choose the arc that ends nearest to the goal, with little risk, and how fast it can be driven."""
        length = _clip(1.6 * speed, 5.0, 14.0)
        goal = self.route.ahead(np.array((x, y)), length)
        vehicle, settings = self._vehicle, self._settings
        prospect = sample_terrain(
            self._country,
            _CURVATURES,
            x=x,
            y=y,
            yaw=yaw,
            length=length,
            size=(vehicle.wheelbase, vehicle.track, vehicle.length / 2),
            margin=_MARGIN,
        )
        detour = np.hypot(prospect.end[:, 0] - goal[0], prospect.end[:, 1] - goal[1])
        steadiness = 6.0 * np.abs(_CURVATURES - self._curvature)
        risk = self._risk(prospect)
        best = int(np.argmin(detour + steadiness + risk))
        self._curvature = float(_CURVATURES[best])
        # Who slides does not stay on the arc.
        beside = slice(max(best - _ASIDE, 0), best + _ASIDE + 1)
        self._climb = float(prospect.climb[best])
        self._lean = 0.5 * float(prospect.lean[best] + prospect.lean[beside].max())
        gentle, hard = settings.cornering
        lateral = gentle + (hard - gentle) * _clip(0.5 + 0.4 * cornering, 0.0, 1.0)
        lateral *= _clip(1.3 - 2 * self._lean, 0.3, 1.0)
        limits = (
            settings.top_speed,
            math.sqrt(lateral / max(abs(self._curvature), 1e-3)),
            self.route.bend_speed(lateral, _BRAKING),
            math.sqrt(settings.bump / max(float(prospect.bend[best]), 1e-3)),
            settings.tilting / max(self._lean, 1e-3),
            settings.top_speed - 0.5 * float(risk[best]),
        )
        # On a climb, way lost is not made up for again.
        level = float(prospect.lean[best]) < settings.steepest
        self._limit = max(min(limits), 2.5 + 20 * min(self._climb, 0.15) * level)

    def _risk(self, prospect: Prospect) -> Float[np.ndarray, " A"]:
        """What arcs risk, in metres of detour."""
        steepest = self._settings.steepest
        belly = self._vehicle.rest_height + self._vehicle.belly_height
        return np.asarray(
            40.0 * (prospect.clearance < 1.6)
            + 4.0 * np.maximum(3.0 - prospect.clearance, 0)
            + 80.0 * np.maximum(prospect.climb - 0.5 * steepest, 0)
            + 20.0 * np.maximum(prospect.descent - 2 * steepest, 0)
            + 120.0 * np.maximum(prospect.lean - 1.1 * steepest, 0)
            + 100.0 * np.maximum(prospect.high_point - 0.6 * belly, 0)
            + 60.0 * np.maximum(prospect.outside, 0)
        )

    def _pedals(self, speed: float, feeling: Feeling) -> tuple[float, float]:
        """Throttle and brake."""
        settings = self._settings
        limit = self._limit
        # A run-up helps on a climb.
        least = 1.2 + 50 * min(max(self._climb - 0.01, 0.0), 0.13)
        if feeling.idea == "throttle" and speed < limit:
            return 0.6 + 0.4 * feeling.strength, 0.0
        if feeling.idea in ("brake", "brake and swerve") and speed > least:
            return 0.0, 0.25 + 0.75 * feeling.strength
        if feeling.idea == "coast" and speed > least:
            return 0.0, 0.0
        wanted = settings.median_speed * math.exp(settings.speed_spread * feeling.speed)
        wanted = max(wanted, least)
        lack = min(wanted, limit) - speed
        throttle = _clip(0.2 + 0.3 * lack + 2 * self._climb, 0.0, 1.0) if lack > -0.6 else 0.0
        return throttle, _clip(-0.25 * (lack + 1), 0.0, 1.0)

    def _steering(self, speed: float, yaw_rate: float, feeling: Feeling) -> float:
        """The arc's curvature, corrected by how fast the vehicle really turns, and some play."""
        vehicle = self._vehicle
        curvature = self._curvature + 0.02 * feeling.play
        angle = math.atan(vehicle.wheelbase * curvature) + 0.12 * (curvature * speed - yaw_rate)
        if "swerve" in feeling.idea and self._lean < 0.6 * self._settings.steepest:
            angle += (0.3 + 0.7 * feeling.strength) * vehicle.max_steer * feeling.side * math.sin(4 * feeling.left)
        # Beyond this, on any ground, more steering only rolls the vehicle over.
        most = math.atan(vehicle.wheelbase * 1.1 * GRAVITY / max(speed, 1.0) ** 2)
        return _clip(_clip(angle, -most, most) / vehicle.max_steer, -1.0, 1.0)


def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
