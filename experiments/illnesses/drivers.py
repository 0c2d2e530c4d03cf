"""Drivers beside the proving ground's own: one that always turns, one that stops often, one that also reverses."""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import DT
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.simulate import Controller
from offpiste.simulation.vehicle.parameters import VehicleParameters

Command = Float[np.ndarray, " U"]

_PULLS_AWAY: Final = 0.35
"""Least throttle of a vehicle at a standstill: below it the clutch does not grip."""


@dataclass
class Weaving:
    """Drives bend after bend on open ground, and back to the middle before the ground ends.

    Attributes:
        bends: smallest and largest curvature, as a share of the tightest turn.
        lateral: lateral acceleration that is aimed at [m/s^2].
        fastest: top speed [m/s].
        radius: distance from the middle at which it turns back [m].
        reverse_every: mean time between two stretches of reversing [s]; 0 for a vehicle that never does.
    """

    vehicle: VehicleParameters
    random: np.random.Generator
    bends: tuple[float, float] = (0.5, 1.0)
    lateral: float = 5.0
    fastest: float = 9.0
    radius: float = 60.0
    reverse_every: float = 0.0
    gear: int = field(default=1, init=False)
    stuck: bool = field(default=False, init=False)
    _left: float = field(default=0.0, init=False)
    _curvature: float = field(default=0.1, init=False)
    _steer: float = field(default=0.0, init=False)
    _stretch: float = field(default=0.0, init=False)
    _reverses: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self._stretch = self.random.exponential(self.reverse_every) if self.reverse_every else math.inf

    def command(self, sample: VehicleSample) -> Command:
        """Throttle, brake, steering and gear for the next `DT`."""
        return np.append(self._pedals_and_wheel(sample), self.gear)

    def _pedals_and_wheel(self, sample: VehicleSample) -> Command:
        speed = _forward_speed(sample)
        self._change_direction(speed)
        self._change_bend(sample)
        wanted = min(math.sqrt(self.lateral / max(abs(self._curvature), 1e-3)), self.fastest)
        wanted = -min(wanted, 2.5) if self._reverses else wanted
        steer = math.atan(self.vehicle.wheelbase * self._curvature) / self.vehicle.max_steer
        # As quickly as a person turns the wheel.
        self._steer += float(np.clip(steer - self._steer, -2.5 * DT, 2.5 * DT))
        if (self.gear < 0) != self._reverses or sample.gear != self.gear:
            return np.array((0.0, 0.6 if abs(speed) > 0.1 else 0.3, self._steer))
        lack = (wanted - speed) * self.gear
        throttle = min(max(0.15 + 0.3 * lack, 0.0), 1.0) if lack > -0.3 else 0.0
        if abs(speed) < 0.3:
            throttle = max(throttle, _PULLS_AWAY)
        return np.array((throttle, min(max(-0.3 * (lack + 0.5), 0.0), 1.0), self._steer))

    def _change_direction(self, speed: float) -> None:
        """Between forwards and reverse, in both cases through a standstill."""
        self._stretch -= DT
        if self._stretch <= 0:
            self._reverses = not self._reverses
            self._stretch = (
                self.random.uniform(4.0, 9.0) if self._reverses else self.random.exponential(self.reverse_every)
            )
        if (self.gear < 0) != self._reverses and abs(speed) < 0.1:
            self.gear = -1 if self._reverses else 1

    def _change_bend(self, sample: VehicleSample) -> None:
        """A new bend every few seconds; towards the middle where the ground ends."""
        self._left -= DT
        x, y, _ = sample.position.tolist()
        tightest = math.tan(self.vehicle.max_steer) / self.vehicle.wheelbase
        if math.hypot(x, y) > self.radius and not self._reverses:
            vx, vy, _ = sample.velocity.tolist()
            side = math.copysign(1.0, -(vx * y - vy * x))
            if vx * x + vy * y > 0 or self._left <= 0:
                self._curvature, self._left = side * 0.5 * tightest, 0.5
        elif self._left <= 0:
            size = self.random.uniform(*self.bends) * tightest
            self._curvature = float(self.random.choice((-1.0, 1.0))) * size
            self._left = float(self.random.uniform(1.5, 6.0))


@dataclass
class Pausing:
    """Another driver, who now and then stops for a while.

    Attributes:
        every: mean time between two stops [s].
        pause: shortest and longest stop, braking included [s].
    """

    driver: Controller
    random: np.random.Generator
    every: float = 15.0
    pause: tuple[float, float] = (5.0, 20.0)
    _until: float = field(default=0.0, init=False)
    _stops: bool = field(default=False, init=False)

    @property
    def stuck(self) -> bool:
        """Whether the driver has given up."""
        return self.driver.stuck

    def command(self, sample: VehicleSample) -> Command:
        """Throttle, brake and steering for the next `DT`."""
        if sample.time >= self._until:
            self._stops = not self._stops if sample.time > 0 else self.random.random() < 0.5
            lasts = self.random.uniform(*self.pause) if self._stops else self.random.exponential(self.every)
            self._until = sample.time + lasts
        if not self._stops:
            return self.driver.command(sample)
        return np.array((0.0, 0.5, float(sample.command[2])))


def _forward_speed(sample: VehicleSample) -> float:
    i, j, k, w = sample.orientation.tolist()
    yaw = math.atan2(2 * (i * j + k * w), 1 - 2 * (j * j + k * k))
    vx, vy, _ = sample.velocity.tolist()
    return float(vx * math.cos(yaw) + vy * math.sin(yaw))
