"""A driver that excites the vehicle: it follows trails, cuts across open ground, and drives until the tyres slip.

It knows slopes, trees and trails (`lookahead.VisibleTerrain`) but not the grip. Ten times a second it picks the arc
that leads best to a point ahead on its route. Its speed follows a random intent, with bursts of throttle, brake and
steering, as fast as the bends, bumps and banks ahead allow.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import GRAVITY
from offpiste.simulation.driver.intent import Intent, RandomIntent
from offpiste.simulation.driver.lookahead import ArcHazards, VisibleTerrain, hazards_along_arcs
from offpiste.simulation.driver.pedal_control import TractionControl
from offpiste.simulation.driver.route import Route
from offpiste.simulation.driver.stuck import StuckRecovery
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.vehicle.parameters import VehicleParameters
from offpiste.simulation.world.world import World


@dataclass(frozen=True)
class DriverSettings:
    """Driving style.

    Attributes:
        median_speed: median of the intended speed [m/s].
        speed_spread: standard deviation of the logarithm of the intended speed.
        top_speed: highest speed [m/s].
        cornering: lateral acceleration that is accepted, lowest and highest over time [m/s^2].
        pause: mean time between manoeuvres (`intent.RandomIntent`) [s].
        off_trail: probability of leaving a trail across open ground at its next stretch.
        max_slope: climb and lean that are avoided (rise over run).
        max_tilt_speed: speed times lean that is accepted [m/s].
        max_bump: vertical acceleration that is accepted [m/s^2].
        standing_start: probability of starting at rest.
        timeout: how long a stuck vehicle tries to get going again [s].
        manoeuvres: mean number of stops, slow, fast and reverse stretches in a minute of driving between them
            (`manoeuvres.ManoeuvringDriver`); 0 for none, and no reverse gear.
    """

    median_speed: float = 6.2
    speed_spread: float = 0.75
    top_speed: float = 12.0
    cornering: tuple[float, float] = (3.0, 7.0)
    pause: float = 3.5
    off_trail: float = 0.35
    max_slope: float = 0.18
    max_tilt_speed: float = 0.8
    max_bump: float = 6.0
    standing_start: float = 0.25
    timeout: float = 15.0
    manoeuvres: float = 0.0


WITH_MANOEUVRES = DriverSettings(top_speed=16.0, max_tilt_speed=1.1, manoeuvres=8.0)
"""The whole range of speeds: standing, crawling, reverse, and as fast as trails allow."""

_CALM = Intent(0.0, 0.0, 0.0, "", 0.0, 1.0, 0.0)
"""Intent of a driver who keeps to a given speed."""

_CURVATURES = np.linspace(-0.22, 0.22, 23)
"""Curvatures of the arcs to choose from [1/m]."""

_REPLAN_STEPS = 5
"""Steps between two choices of an arc."""

_LEVEL = 0.04
"""Climb on which a vehicle at a standstill can be expected to drive away (rise over run)."""

_TIPPING = 0.3
"""Sine of the roll beyond which nothing but staying upright counts."""

_NEIGHBOURS = 2
"""Number of arcs to either side onto which a vehicle may slide."""

_BRAKING = 3.5
"""Deceleration that is assumed before bends [m/s^2]."""

_MARGIN = 9.0
"""Distance kept from the world's border [m]."""


class Driver:
    """Commands for a vehicle in a world.

    Args:
        rng: random numbers of the route, the intent and the start.
    """

    def __init__(
        self,
        world: World,
        vehicle: VehicleParameters,
        rng: np.random.Generator,
        settings: DriverSettings | None = None,
    ) -> None:
        self._vehicle, self._settings = vehicle, settings or DriverSettings()
        self._terrain, self._rng = VisibleTerrain.of(world), rng
        self.route = Route(self._terrain, rng, off_trail=self._settings.off_trail)
        self._intent = RandomIntent(rng, pause=self._settings.pause)
        self._recovery = StuckRecovery(self._settings.timeout)
        self._steps, self._curvature, self._speed_limit = 0, 0.0, self._settings.top_speed
        self._climb, self._lean = 0.0, 0.0
        self._traction = TractionControl()

    @property
    def stuck(self) -> bool:
        """Whether it has given up: nothing that it tried has moved the vehicle."""
        return self._recovery.timed_out

    @property
    def recovering(self) -> bool:
        """Whether the vehicle makes no progress, and it tries to get it going again."""
        return self._recovery.stuck

    def forget_spin(self) -> None:
        """Begin anew with the throttle at which wheels are expected to spin: after others have spun them."""
        self._traction = TractionControl()

    def start(self) -> tuple[float, float, float, float]:
        """Start of a drive: x, y [m], yaw [rad] along a trail, speed [m/s]."""
        chance, speed = self._rng.random(), float(self._rng.uniform(2.0, 7.0))
        x, y, yaw, climb = self.route.start()
        return x, y, yaw, 0.0 if chance < self._settings.standing_start and climb < _LEVEL else speed

    def command(self, sample: VehicleSample, *, keep: float | None = None) -> Float[np.ndarray, " 3"]:
        """Throttle, brake and steering for the next `conventions.DT`.

        Args:
            keep: speed to keep to, as far as the ground ahead allows, instead of the random intent [m/s]; the vehicle
                never counts as stuck then.
        """
        x, y, yaw, speed = pose_and_speed(sample)
        i, j, k, w = sample.orientation.tolist()
        spin = sum(sample.wheel_speed.tolist()) / 4 - speed
        intent = self._intent.advance() if keep is None else _CALM
        if self._steps % _REPLAN_STEPS == 0:
            self._choose_arc(x, y, yaw, max(speed, 0.0), intent.cornering)
        self._steps += 1
        # A vehicle that stops uphill may not drive away again.
        stopping = intent.manoeuvre == "stop" and self._climb < _LEVEL
        was_stuck = self._recovery.stuck
        self._recovery.advance(x, y, speed=speed, stop_intended=stopping or keep is not None)
        leans_left = -2 * (j * k + i * w)
        if self._recovery.stuck and keep is None:
            if not was_stuck:
                self.route.rejoin(np.array((x, y)), np.array((math.cos(yaw), math.sin(yaw))))
            # With one wheel in the air, only a fast one passes torque on through a limited-slip differential.
            airborne = float(np.ptp(sample.wheel_speed)) > 2.0
            throttle, allowed_spin, steer = self._recovery.recover(speed, leans_left)
            return np.array((self._traction.throttle(throttle, spin, allowed_spin + 12.0 * airborne), 0.0, steer))
        steer = self._steering(speed, float(sample.angular_velocity[2]), intent)
        throttle, brake = (0.0, 0.3 + 0.5 * intent.strength) if stopping else self._pedals(speed, intent, keep)
        allowed_spin = 0.2 + 0.25 * max(speed, 0.0)
        if intent.manoeuvre == "throttle" and self._climb < _LEVEL:
            allowed_spin += 3.0 + 6.0 * intent.strength
        tips_left = leans_left - 0.25 * float(sample.angular_velocity[0])
        if abs(tips_left) > _TIPPING and speed > 3.0:
            # About to roll over: steer into the fall, and off the pedals.
            throttle, brake = 0.3 * throttle, 0.0
            steer = _clip(steer + 5 * (tips_left - math.copysign(_TIPPING, tips_left)), -1.0, 1.0)
        return np.array((self._traction.throttle(throttle, spin, allowed_spin), brake, steer))

    def _choose_arc(self, x: float, y: float, yaw: float, speed: float, cornering: float) -> None:
        """Choose the arc that ends nearest to the goal, with little risk, and the speed that it allows."""
        length = _clip(1.6 * speed, 5.0, 14.0)
        goal = self.route.ahead(np.array((x, y)), length)
        vehicle = self._vehicle
        hazards = hazards_along_arcs(
            self._terrain,
            _CURVATURES,
            x=x,
            y=y,
            yaw=yaw,
            length=length,
            size=(vehicle.wheelbase, vehicle.track, vehicle.length / 2),
            margin=_MARGIN,
        )
        detour = np.hypot(hazards.end[:, 0] - goal[0], hazards.end[:, 1] - goal[1])
        steadiness = 6.0 * np.abs(_CURVATURES - self._curvature)
        risk = self._risk(hazards)
        best = int(np.argmin(detour + steadiness + risk))
        self._curvature = float(_CURVATURES[best])
        # A vehicle that slides does not stay on its arc.
        beside = slice(max(best - _NEIGHBOURS, 0), best + _NEIGHBOURS + 1)
        self._climb = float(hazards.climb[best])
        self._lean = 0.5 * float(hazards.lean[best] + hazards.lean[beside].max())
        self._speed_limit = self._limit_speed(hazards, best, float(risk[best]), cornering)

    def _limit_speed(self, hazards: ArcHazards, arc: int, risk: float, cornering: float) -> float:
        """Speed that the chosen arc and the bends behind it allow [m/s]."""
        settings = self._settings
        gentle, hard = settings.cornering
        lateral = gentle + (hard - gentle) * _clip(0.5 + 0.4 * cornering, 0.0, 1.0)
        lateral *= _clip(1.3 - 2 * self._lean, 0.3, 1.0)
        limits = (
            settings.top_speed,
            math.sqrt(lateral / max(abs(self._curvature), 1e-3)),
            self.route.bend_speed(lateral, _BRAKING),
            math.sqrt(settings.max_bump / max(float(hazards.vertical_curvature[arc]), 1e-3)),
            settings.max_tilt_speed / max(self._lean, 1e-3),
            settings.top_speed - 0.5 * risk,
        )
        # On a climb, speed that is lost cannot be regained.
        level = float(hazards.lean[arc]) < settings.max_slope
        return max(min(limits), 2.5 + 20 * min(self._climb, 0.15) * level)

    def _risk(self, hazards: ArcHazards) -> Float[np.ndarray, " A"]:
        """Risk of each arc, as the detour that it is worth [m]."""
        max_slope = self._settings.max_slope
        belly = self._vehicle.rest_height + self._vehicle.belly_height
        return np.asarray(
            40.0 * (hazards.clearance < 1.6)
            + 4.0 * np.maximum(3.0 - hazards.clearance, 0)
            + 80.0 * np.maximum(hazards.climb - 0.5 * max_slope, 0)
            + 20.0 * np.maximum(hazards.descent - 2 * max_slope, 0)
            + 120.0 * np.maximum(hazards.lean - 1.1 * max_slope, 0)
            + 100.0 * np.maximum(hazards.protrusion - 0.6 * belly, 0)
            + 60.0 * np.maximum(hazards.border_overlap, 0)
        )

    def _pedals(self, speed: float, intent: Intent, keep: float | None) -> tuple[float, float]:
        """Throttle and brake."""
        settings = self._settings
        limit = self._speed_limit
        # A run-up helps on a climb.
        least = 1.2 + 50 * min(max(self._climb - 0.01, 0.0), 0.13)
        if intent.manoeuvre == "throttle" and speed < limit:
            return 0.6 + 0.4 * intent.strength, 0.0
        if intent.manoeuvre in ("brake", "brake and swerve") and speed > least:
            return 0.0, 0.25 + 0.75 * intent.strength
        if intent.manoeuvre == "coast" and speed > least:
            return 0.0, 0.0
        wanted = settings.median_speed * math.exp(settings.speed_spread * intent.speed) if keep is None else keep
        wanted = max(wanted, least)
        lack = min(wanted, limit) - speed
        throttle = _clip(0.2 + 0.3 * lack + 2 * self._climb, 0.0, 1.0) if lack > -0.6 else 0.0
        return throttle, _clip(-0.25 * (lack + 1), 0.0, 1.0)

    def _steering(self, speed: float, yaw_rate: float, intent: Intent) -> float:
        """Steering for the arc's curvature, corrected by the vehicle's yaw rate, with some random steering."""
        vehicle = self._vehicle
        curvature = self._curvature + 0.02 * intent.steering
        angle = math.atan(vehicle.wheelbase * curvature) + 0.12 * (curvature * speed - yaw_rate)
        if "swerve" in intent.manoeuvre and self._lean < 0.6 * self._settings.max_slope:
            angle += (0.3 + 0.7 * intent.strength) * vehicle.max_steer * intent.side * math.sin(4 * intent.time_left)
        # Beyond this, on any ground, more steering only rolls the vehicle over.
        most = math.atan(vehicle.wheelbase * 1.1 * GRAVITY / max(speed, 1.0) ** 2)
        return _clip(_clip(angle, -most, most) / vehicle.max_steer, -1.0, 1.0)


def pose_and_speed(sample: VehicleSample) -> tuple[float, float, float, float]:
    """Pose x, y [m] and yaw [rad], and the horizontal speed forwards, below zero in reverse [m/s]."""
    i, j, k, w = sample.orientation.tolist()
    yaw = math.atan2(2 * (i * j + k * w), 1 - 2 * (j * j + k * k))
    x, y, _ = sample.position.tolist()
    vx, vy, _ = sample.velocity.tolist()
    return x, y, yaw, vx * math.cos(yaw) + vy * math.sin(yaw)


def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
