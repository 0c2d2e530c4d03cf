"""A driver that excites the vehicle's dynamics: it follows trails, crosses open ground, and makes the tyres slip.

It knows slopes, trees and trails (`route.VisibleTerrain`) but not the grip. Ten times a second it selects the best arc
towards a point ahead on its route. Its speed follows a random intent with bursts of throttle, brake and steering, as
far as the bends, bumps and banks ahead allow.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import DT, GRAVITY
from offpiste.simulation.driver.route import ArcHazards, Route, VisibleTerrain, hazards_along_arcs
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.vehicle.parameters import VehicleParameters
from offpiste.simulation.world.world import World


@dataclass(frozen=True)
class DriverSettings:
    """Driving style."""

    median_speed: float = 6.2  # median of the intended speed [m/s]
    speed_spread: float = 0.75  # standard deviation of the logarithm of the intended speed
    top_speed: float = 12.0  # highest speed [m/s]
    # Range of the accepted lateral acceleration, which varies over time [m/s^2]
    cornering: tuple[float, float] = (3.0, 7.0)
    pause: float = 3.5  # mean time between the manoeuvres of `RandomIntent` [s]
    off_trail: float = 0.35  # probability of leaving a trail across open ground at its next stretch
    max_slope: float = 0.18  # climb and lean that are avoided (rise over run)
    max_tilt_speed: float = 0.8  # accepted product of speed and lean [m/s]
    max_bump: float = 6.0  # accepted vertical acceleration [m/s^2]
    standing_start: float = 0.25  # probability of starting at rest
    timeout: float = 15.0  # time after which a stuck vehicle gives up [s]
    # Mean number of stops, slow, fast and reverse stretches (`manoeuvres.ManoeuvringDriver`) per minute of driving
    # between them; 0 for none, and no reverse gear
    manoeuvres: float = 0.0


WITH_MANOEUVRES = DriverSettings(top_speed=16.0, max_tilt_speed=1.1, manoeuvres=8.0)
"""Settings for the whole range of speeds, standing and reverse included."""

_CORRELATION_TIMES = (7.0, 6.0, 0.7)
"""Correlation times of speed, cornering and steering [s]."""
_KEEP = [(math.exp(-DT / time), math.sqrt(1 - math.exp(-2 * DT / time))) for time in _CORRELATION_TIMES]
"""Weights of the old value and of new noise in a step of `DT`."""

_MANOEUVRES: dict[str, tuple[float, float, float]] = {
    "throttle": (0.24, 0.6, 2.0),
    "brake": (0.14, 0.4, 1.4),
    "coast": (0.12, 0.6, 2.0),
    "swerve": (0.28, 0.8, 2.4),
    "brake and swerve": (0.16, 0.6, 1.6),
    "stop": (0.06, 2.0, 5.0),
}
"""Probability, shortest and longest duration [s]; a stop includes slowing down."""
_PROPORTIONAL, _INTEGRAL, _MOST = 0.35, 0.4, 0.8
"""Speed control: throttle per lack of speed [s/m], its integral gain [1/m] and limit."""
_BRAKE, _TOLERANCE = 0.35, 0.15
"""Speed control: brake per excess speed [s/m], and tolerated excess [m/s]."""

_LAG, _SPIN_LAG = 0.1, 0.05
"""Time constants of the throttle, and of the measurement of spin [s]."""
_GAIN, _LEARNING_RATE = 0.2, 0.15
"""Throttle reduction per excess spin [s/m], and its integral gain [1/m]."""
_USUAL_THROTTLE, _FORGETTING_TIME = 0.8, 2.0
"""Expected throttle at which wheels spin, and time constant of the return to it while they grip [s]."""
_PROGRESS, _DETECTION_TIME = 2.0, 1.5
"""Progress that frees a stuck vehicle [m]; time without it after which a vehicle counts as stuck [s]."""
_ATTEMPT = 7.0
"""Duration of an attempt [s]: dig gently, roll back, charge."""


class Intent(NamedTuple):
    """Intent of the driver at a time; the default keeps a given speed."""

    speed: float = 0.0  # Gauss-Markov processes of mean 0 and standard deviation 1
    cornering: float = 0.0
    steering: float = 0.0
    manoeuvre: str = ""  # current manoeuvre (`_MANOEUVRES`), mostly ""
    strength: float = 0.0  # strength of the manoeuvre, 0..1
    side: float = 1.0  # side of the manoeuvre, -1 or 1
    time_left: float = 0.0  # remaining time of the manoeuvre [s]


class RandomIntent:
    """Random intents every `DT`, independent of the ground, with manoeuvres every `pause` [s] on average."""

    def __init__(self, rng: np.random.Generator, *, pause: float) -> None:
        self._rng, self._pause = rng, pause
        self._intent = Intent(*rng.standard_normal(3).tolist())
        self._until_next = float(rng.exponential(pause))

    def advance(self) -> Intent:
        """Return the next intent."""
        noise, last, rng = self._rng.standard_normal(3).tolist(), self._intent, self._rng
        speed, cornering, steering = (
            k * old + r * new for (k, r), old, new in zip(_KEEP, last[:3], noise, strict=True)
        )
        left = last.time_left - DT
        self._until_next -= DT
        if self._until_next <= 0:
            probabilities = [probability for probability, _, _ in _MANOEUVRES.values()]
            name, (_, shortest, longest) = list(_MANOEUVRES.items())[int(rng.choice(len(_MANOEUVRES), p=probabilities))]
            left, strength, side = rng.uniform(shortest, longest), rng.random(), rng.choice((-1.0, 1.0))
            self._intent = Intent(speed, cornering, steering, name, float(strength), float(side), float(left))
            self._until_next = float(left + rng.exponential(self._pause))
        else:
            name = last.manoeuvre if left > 0 else ""
            self._intent = Intent(speed, cornering, steering, name, last.strength, last.side, left)
        return self._intent


class SpeedControl:
    """Proportional-integral control of a low speed."""

    def __init__(self) -> None:
        self._held = 0.1

    def pedals(self, lack: float) -> tuple[float, float]:
        """Return throttle and brake, 0..1, for a speed below the wanted one by `lack`, along the gear [m/s]."""
        self._held = min(max(self._held + _INTEGRAL * lack * DT, 0.0), _MOST)
        brake = _clip(-_BRAKE * (lack + _TOLERANCE), 0.0, 1.0)
        return (0.0, brake) if brake > 0 else (_clip(self._held + _PROPORTIONAL * lack, 0.0, 1.0), 0.0)


class TractionControl:
    """Limits the requested throttle by the wheels' spin.

    A sliding wheel integrates excess torque; a proportional-integral controller holds its spin.
    """

    def __init__(self) -> None:
        self._throttle, self._spin, self._held = 0.0, 0.0, _USUAL_THROTTLE

    def throttle(self, requested: float, spin: float, allowed_spin: float) -> float:
        """Return the throttle for the next `DT`, 0..1, for a requested throttle, measured and allowed spin.

        Spin is the rolling speed of the wheels minus the vehicle's speed [m/s].
        """
        self._spin += (spin - self._spin) * DT / (_SPIN_LAG + DT)
        margin = allowed_spin - self._spin
        most = self._held + _GAIN * margin
        if most < requested:
            self._held = min(max(self._held + _LEARNING_RATE * DT * margin, 0.15), 1.0)
        else:
            self._held += (_USUAL_THROTTLE - self._held) * DT / _FORGETTING_TIME
        self._throttle += (min(requested, max(most, 0.0)) - self._throttle) * DT / (_LAG + DT)
        return self._throttle


class StuckRecovery:
    """Detects a lack of progress and tries to free the vehicle without reverse gear, up to a timeout [s]."""

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self._place: tuple[float, float] | None = None
        self._time = self._attempt_time = 0.0

    @property
    def stuck(self) -> bool:
        """Whether the vehicle makes no progress."""
        return self._time > _DETECTION_TIME

    @property
    def timed_out(self) -> bool:
        """Whether the recovery has taken too long."""
        return self._time > self._timeout

    def advance(self, x: float, y: float, *, speed: float, stop_intended: bool) -> None:
        """Update with the vehicle's position [m] and speed [m/s] after another `DT`."""
        if self._place is None or math.dist((x, y), self._place) > _PROGRESS or (speed > 1.0 and not self.stuck):
            self._place, self._time, self._attempt_time = (x, y), 0.0, 0.0
        elif not stop_intended:
            self._time += DT

    def recover(self, speed: float, leans_left: float) -> tuple[float, float, float]:
        """Return throttle, allowed spin [m/s] and steering, at a forward speed [m/s] and downward slope to the left."""
        # Do not interrupt a vehicle that begins to move.
        self._attempt_time += DT if speed < 0.25 else 0.0
        phase = self._attempt_time % _ATTEMPT
        downhill = min(max(10.0 * leans_left, -1.0), 1.0)
        if phase < 0.6 * _ATTEMPT:
            # A little slip pulls best; spinning wheels dig in.
            return 1.0, 0.15 + 0.2 * abs(speed), 0.3 * math.sin(2.5 * self._attempt_time)
        if phase < 0.8 * _ATTEMPT:
            # Roll back for a run-up on a climb; steering uphill turns the nose downhill.
            return 0.0, 1.0, -0.8 * downhill if speed < -0.1 else 0.0
        return 1.0, 2.0, downhill


_CURVATURES = np.linspace(-0.22, 0.22, 23)
"""Curvatures of the candidate arcs [1/m]."""

_REPLAN_STEPS, _NEIGHBOURS = 5, 2
"""Steps between selections of an arc; number of arcs on either side onto which the vehicle may slide."""
_LEVEL = 0.04
"""Climb on which a stopped vehicle can be expected to drive away (rise over run)."""
_TIPPING = 0.3
"""Sine of the roll beyond which the driver only prevents a rollover."""
_BRAKING = 3.5
"""Assumed deceleration before bends [m/s^2]."""
_MARGIN = 9.0
"""Distance kept from the world's border [m]."""


class Driver:
    """Commands for a vehicle in a world, with random numbers for the route, the intent and the start."""

    def __init__(
        self, world: World, vehicle: VehicleParameters, rng: np.random.Generator, settings: DriverSettings | None = None
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
        """Whether the driver has given up after failing to move the vehicle."""
        return self._recovery.timed_out

    @property
    def recovering(self) -> bool:
        """Whether the driver tries to move a vehicle that makes no progress."""
        return self._recovery.stuck

    def forget_spin(self) -> None:
        """Reset the traction control, after another controller has spun the wheels."""
        self._traction = TractionControl()

    def start(self) -> tuple[float, float, float, float]:
        """Start of a drive along a trail: x, y [m], yaw [rad], speed [m/s]."""
        chance, speed = self._rng.random(), float(self._rng.uniform(2.0, 7.0))
        x, y, yaw, climb = self.route.start()
        return x, y, yaw, 0.0 if chance < self._settings.standing_start and climb < _LEVEL else speed

    def command(self, sample: VehicleSample, *, keep: float | None = None) -> Float[np.ndarray, " 3"]:
        """Return the throttle, brake and steering for the next `conventions.DT`.

        Args:
            keep: speed to keep instead of the random intent, as far as the ground ahead allows [m/s]; the vehicle then
                never counts as stuck.
        """
        (x, y), yaw, speed = sample.position[:2].tolist(), sample.yaw, sample.forward_speed
        i, j, k, w = sample.orientation.tolist()
        spin = sum(sample.wheel_speed.tolist()) / 4 - speed
        intent = self._intent.advance() if keep is None else Intent()
        if self._steps % _REPLAN_STEPS == 0:
            self._choose_arc(x, y, yaw, max(speed, 0.0), intent.cornering)
        self._steps += 1
        # A vehicle that stops uphill may not be able to drive away.
        stopping = intent.manoeuvre == "stop" and self._climb < _LEVEL
        was_stuck = self._recovery.stuck
        self._recovery.advance(x, y, speed=speed, stop_intended=stopping or keep is not None)
        leans_left = -2 * (j * k + i * w)
        if self._recovery.stuck and keep is None:
            if not was_stuck:
                self.route.rejoin(np.array((x, y)), np.array((math.cos(yaw), math.sin(yaw))))
            # With a wheel in the air, a limited-slip differential only transmits torque if that wheel spins fast.
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
            # About to roll over: steer into the fall and release the pedals.
            throttle, brake = 0.3 * throttle, 0.0
            steer = _clip(steer + 5 * (tips_left - math.copysign(_TIPPING, tips_left)), -1.0, 1.0)
        return np.array((self._traction.throttle(throttle, spin, allowed_spin), brake, steer))

    def _choose_arc(self, x: float, y: float, yaw: float, speed: float, cornering: float) -> None:
        """Select an arc that ends near the goal at little risk, and the speed it allows."""
        length = _clip(1.6 * speed, 5.0, 14.0)
        goal = self.route.ahead(np.array((x, y)), length)
        size = (self._vehicle.wheelbase, self._vehicle.track, self._vehicle.length / 2)
        hazards = hazards_along_arcs(self._terrain, _CURVATURES, (x, y, yaw), length, size, _MARGIN)
        detour = np.hypot(hazards.end[:, 0] - goal[0], hazards.end[:, 1] - goal[1])
        risk = self._risk(hazards)
        best = int(np.argmin(detour + 6.0 * np.abs(_CURVATURES - self._curvature) + risk))
        self._curvature = float(_CURVATURES[best])
        # A sliding vehicle does not stay on its arc.
        beside = slice(max(best - _NEIGHBOURS, 0), best + _NEIGHBOURS + 1)
        self._climb = float(hazards.climb[best])
        self._lean = 0.5 * float(hazards.lean[best] + hazards.lean[beside].max())
        self._speed_limit = self._limit_speed(hazards, best, float(risk[best]), cornering)

    def _limit_speed(self, hazards: ArcHazards, arc: int, risk: float, cornering: float) -> float:
        """Return the speed allowed by the selected arc and the bends beyond it [m/s]."""
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
        # Speed lost on a climb cannot be regained.
        level = float(hazards.lean[arc]) < settings.max_slope
        return max(min(limits), 2.5 + 20 * min(self._climb, 0.15) * level)

    def _risk(self, hazards: ArcHazards) -> Float[np.ndarray, " A"]:
        """Return the risk of each arc, expressed as a detour [m]."""
        max_slope, belly = self._settings.max_slope, self._vehicle.rest_height + self._vehicle.belly_height
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
        """Return the throttle and brake."""
        settings, limit = self._settings, self._speed_limit
        # A run-up helps on a climb.
        least = 1.2 + 50 * min(max(self._climb - 0.01, 0.0), 0.13)
        if intent.manoeuvre == "throttle" and speed < limit:
            return 0.6 + 0.4 * intent.strength, 0.0
        if intent.manoeuvre in ("brake", "brake and swerve") and speed > least:
            return 0.0, 0.25 + 0.75 * intent.strength
        if intent.manoeuvre == "coast" and speed > least:
            return 0.0, 0.0
        wanted = settings.median_speed * math.exp(settings.speed_spread * intent.speed) if keep is None else keep
        lack = min(max(wanted, least), limit) - speed
        throttle = _clip(0.2 + 0.3 * lack + 2 * self._climb, 0.0, 1.0) if lack > -0.6 else 0.0
        return throttle, _clip(-0.25 * (lack + 1), 0.0, 1.0)

    def _steering(self, speed: float, yaw_rate: float, intent: Intent) -> float:
        """Return the steering for the arc's curvature with yaw-rate feedback and some random steering."""
        vehicle = self._vehicle
        curvature = self._curvature + 0.02 * intent.steering
        angle = math.atan(vehicle.wheelbase * curvature) + 0.12 * (curvature * speed - yaw_rate)
        if "swerve" in intent.manoeuvre and self._lean < 0.6 * self._settings.max_slope:
            angle += (0.3 + 0.7 * intent.strength) * vehicle.max_steer * intent.side * math.sin(4 * intent.time_left)
        # On any ground, more steering would only roll the vehicle over.
        most = math.atan(vehicle.wheelbase * 1.1 * GRAVITY / max(speed, 1.0) ** 2)
        return _clip(_clip(angle, -most, most) / vehicle.max_steer, -1.0, 1.0)


def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
