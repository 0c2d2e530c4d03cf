"""Manoeuvres between stretches of trail: stops, crawling, reverse, fast stretches, digging in and rocking free.

They extend `driver.Driver`, which rarely stops and never reverses, to the whole range of speeds.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import DT
from offpiste.simulation.driver.driver import Driver, SpeedControl
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.vehicle.parameters import VehicleParameters

Pedals = tuple[float, float, float]
"""Throttle, brake and steering."""

_STANDING_TIME, _CRAWLING_TIME, _REVERSING_TIME, _FAST_TIME = (1.0, 8.0), (4.0, 10.0), (3.0, 10.0), (6.0, 12.0)
"""Range of durations, without slowing down and shifting [s]."""
_DIGGING_TIME, _ROCKING_TIME = (0.8, 2.5), (1.5, 3.5)
"""Range of durations of full throttle without traction control, and of reverse between attempts [s]."""

_CRAWLING, _REVERSING = (0.3, 1.5), (0.8, 3.0)
"""Range of speeds [m/s]."""
_CHANCES = (0.2, 0.2, 0.3, 0.3)
"""Probabilities of a stop, crawling, reverse and a fast stretch."""

_DIGGING = 0.3
"""Probability of starting with full throttle after a stop."""
_ATTEMPT = 3.0
"""Time in which a stuck vehicle tries to drive on before it is rocked free [s]."""

_STANDSTILL = 0.1
"""Speed below which gears are changed [m/s]."""
_SPACING, _MEMORY = 0.3, 200
"""Spacing [m] and number of the remembered positions of the rear axle."""
_REVERSE_LOOKAHEAD = 3.0
"""Distance of the target on the path in reverse [m]."""
_STEERING_RATE = 2.5
"""Steering rate in reverse [1/s]."""


class ManoeuvringDriver:
    """A driver on trails with random manoeuvres.

    Args:
        rate: mean number of manoeuvres per minute of driving between them.
        fastest: speed of fast stretches, as far as the trail allows [m/s].
    """

    def __init__(
        self, driver: Driver, vehicle: VehicleParameters, rng: np.random.Generator, *, rate: float, fastest: float
    ) -> None:
        self._driver, self._vehicle, self._rng = driver, vehicle, rng
        self._pause, self._fastest = 60.0 / rate, fastest
        self._path: deque[tuple[float, float]] = deque(maxlen=_MEMORY)
        self._gear, self._steer = 1, 0.0
        self._pedals = self._drive()

    @property
    def stuck(self) -> bool:
        """Whether the driver has given up after failing to move the vehicle."""
        return self._driver.stuck

    def command(self, sample: VehicleSample) -> Float[np.ndarray, " 4"]:
        """Return the throttle, brake, steering and gear for the next `conventions.DT`."""
        self._sample, self._speed = sample, sample.forward_speed
        throttle, brake, self._steer = next(self._pedals)
        return np.array((throttle, brake, self._steer, self._gear))

    def _drive(self) -> Iterator[Pedals]:
        """Yield the commands of the whole drive, one per sample."""
        kinds: tuple[Callable[[], Iterator[Pedals]], ...] = (self._stand, self._crawl, self._reverse, self._rush)
        while True:
            yield from self._follow_trail(float(self._rng.exponential(self._pause)))
            yield from kinds[int(self._rng.choice(len(kinds), p=_CHANCES))]()

    def _follow_trail(self, seconds: float) -> Iterator[Pedals]:
        """Drive on trails for a time and until the vehicle is free; rock a stuck vehicle with the reverse gear."""
        left, attempt = seconds, 0.0
        while left > 0 or self._driver.recovering:
            yield self._follow()
            left -= DT
            attempt = attempt + DT if self._driver.recovering else 0.0
            if attempt > _ATTEMPT and not self._driver.stuck:
                yield from self._dig()
                yield from self._back_up(self._between(_ROCKING_TIME), 4.0, beyond_path=True)
                attempt = 0.0

    def _stand(self) -> Iterator[Pedals]:
        """Stop, stand, and start again, in some cases with full throttle."""
        strength = self._between((0.2, 1.0))
        yield from self._stop(strength)
        yield from self._pressing(0.0, max(strength, 0.4), self._between(_STANDING_TIME))
        if self._rng.random() < _DIGGING:
            yield from self._dig()

    def _crawl(self) -> Iterator[Pedals]:
        """Follow the route at walking speed."""
        wanted, control = self._between(_CRAWLING), SpeedControl()
        until = self._sample.time + self._between(_CRAWLING_TIME)
        while self._sample.time < until:
            steer = self._follow(wanted)[2]
            yield *control.pedals(wanted - self._speed), steer

    def _rush(self) -> Iterator[Pedals]:
        """Follow the route as fast as bends, bumps and banks allow."""
        until = self._sample.time + self._between(_FAST_TIME)
        while self._sample.time < until:
            yield self._follow(self._fastest)

    def _reverse(self) -> Iterator[Pedals]:
        """Reverse along the driven path."""
        yield from self._stop(self._between((0.15, 0.4)))
        yield from self._back_up(self._between(_REVERSING_TIME), self._between(_REVERSING))

    def _dig(self) -> Iterator[Pedals]:
        """Apply full throttle without traction control, which spins the wheels on soft ground."""
        until = self._sample.time + self._between(_DIGGING_TIME)
        while self._sample.time < until and self._speed < 3.0:
            yield 1.0, 0.0, self._follow(3.0)[2]
        self._driver.forget_spin()

    def _stop(self, strength: float) -> Iterator[Pedals]:
        """Brake to a standstill on the route."""
        while abs(self._speed) > 1.0:
            yield 0.0, strength, self._follow(0.0)[2]
        yield from self._pressing(0.0, max(strength, 0.4), 0.3)

    def _back_up(self, seconds: float, wanted: float, *, beyond_path: bool = False) -> Iterator[Pedals]:
        """Reverse for a time along the remembered path, and if requested straight beyond it."""
        if self._steering_back() is None and not beyond_path:
            return
        yield from self._shift(-1)
        control, until = SpeedControl(), self._sample.time + seconds
        while self._sample.time < until:
            steer = self._steering_back()
            if steer is None and not beyond_path:
                break
            yield *control.pedals(wanted + self._speed), self._turned_to(0.0) if steer is None else steer
        yield from self._shift(1)

    def _shift(self, gear: int) -> Iterator[Pedals]:
        """Change gear at a standstill, holding the brake."""
        while self._sample.gear != gear:
            if math.hypot(*self._sample.velocity[:2]) < _STANDSTILL:
                self._gear = gear
            yield 0.0, 0.7, self._steer

    def _pressing(self, throttle: float, brake: float, seconds: float) -> Iterator[Pedals]:
        until = self._sample.time + seconds
        while self._sample.time < until:
            yield throttle, brake, self._steer

    def _steering_back(self) -> float | None:
        """Return the steering along the remembered path, consuming it; None where it ends or is not behind."""
        rear, path = self._rear_axle(), self._path
        while path and math.dist(path[-1], rear) < _REVERSE_LOOKAHEAD:
            path.pop()
        if not path:
            return None
        dx, dy = path[-1][0] - rear[0], path[-1][1] - rear[1]
        c, s = math.cos(self._sample.yaw), math.sin(self._sample.yaw)
        behind, left = -(dx * c + dy * s), dy * c - dx * s
        if behind < abs(left):
            return None  # the vehicle slid off its path
        # Circle through the rear axle and the target, tangential to the vehicle.
        steer = math.atan(self._vehicle.wheelbase * 2 * left / (dx * dx + dy * dy)) / self._vehicle.max_steer
        return self._turned_to(min(max(steer, -1.0), 1.0))

    def _turned_to(self, steer: float) -> float:
        """Return the steering after one step towards a target at the limited rate."""
        return self._steer + min(max(steer - self._steer, -_STEERING_RATE * DT), _STEERING_RATE * DT)

    def _rear_axle(self) -> tuple[float, float]:
        half, (x, y, _), yaw = 0.5 * self._vehicle.wheelbase, self._sample.position.tolist(), self._sample.yaw
        return x - half * math.cos(yaw), y - half * math.sin(yaw)

    def _follow(self, keep: float | None = None) -> Pedals:
        """Return the command of the driver on trails, and remember the current position as part of the path."""
        here = self._rear_axle()
        if self._speed > 0 and (not self._path or math.dist(self._path[-1], here) > _SPACING):
            self._path.append(here)
        throttle, brake, steer = self._driver.command(self._sample, keep=keep).tolist()
        return throttle, brake, steer

    def _between(self, limits: tuple[float, float]) -> float:
        return float(self._rng.uniform(*limits))
