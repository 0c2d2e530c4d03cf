"""The driver's random intent: wandering speed, cornering and steering, and sudden manoeuvres.

It excites the vehicle's dynamics as in system identification, and does not depend on the ground.
"""

import math
from typing import Literal, NamedTuple

import numpy as np

from offpiste.core.conventions import DT

Manoeuvre = Literal["", "throttle", "brake", "coast", "swerve", "brake and swerve", "stop"]

_CORRELATION_TIMES = (7.0, 6.0, 0.7)
"""Correlation times of speed, cornering and steering [s]."""

_KEEP = [(math.exp(-DT / time), math.sqrt(1 - math.exp(-2 * DT / time))) for time in _CORRELATION_TIMES]
"""Factors of the old value and of fresh noise in a step of `DT`."""

_MANOEUVRES: dict[Manoeuvre, tuple[float, float, float]] = {
    "throttle": (0.24, 0.6, 2.0),
    "brake": (0.14, 0.4, 1.4),
    "coast": (0.12, 0.6, 2.0),
    "swerve": (0.28, 0.8, 2.4),
    "brake and swerve": (0.16, 0.6, 1.6),
    "stop": (0.06, 2.0, 5.0),
}
"""Probability, and shortest and longest duration [s]; slowing down is part of a stop."""


class Intent(NamedTuple):
    """Intent at one moment.

    Attributes:
        speed, cornering, steering: Gauss-Markov processes of mean 0 and standard deviation 1.
        manoeuvre: what is done for a while, "" most of the time.
        strength: strength of the manoeuvre, 0..1.
        side: side of the manoeuvre, -1 or 1.
        time_left: until the manoeuvre ends [s].
    """

    speed: float
    cornering: float
    steering: float
    manoeuvre: Manoeuvre
    strength: float
    side: float
    time_left: float


class RandomIntent:
    """A stream of intents, one every `DT`.

    Args:
        pause: mean time between manoeuvres [s].
    """

    def __init__(self, rng: np.random.Generator, *, pause: float) -> None:
        self._rng, self._pause = rng, pause
        self._processes = rng.standard_normal(3).tolist()
        self._manoeuvre: Manoeuvre = ""
        self._strength, self._side = 0.0, 1.0
        self._time_left, self._until_next = 0.0, float(rng.exponential(pause))

    def advance(self) -> Intent:
        """The next intent."""
        noise = self._rng.standard_normal(3).tolist()
        self._processes = [k * old + r * new for (k, r), old, new in zip(_KEEP, self._processes, noise, strict=True)]
        self._time_left -= DT
        self._until_next -= DT
        if self._until_next <= 0:
            self._begin_manoeuvre()
        elif self._time_left <= 0:
            self._manoeuvre = ""
        speed, cornering, steering = self._processes
        return Intent(speed, cornering, steering, self._manoeuvre, self._strength, self._side, self._time_left)

    def _begin_manoeuvre(self) -> None:
        probabilities = [probability for probability, _, _ in _MANOEUVRES.values()]
        self._manoeuvre = list(_MANOEUVRES)[int(self._rng.choice(len(_MANOEUVRES), p=probabilities))]
        _, shortest, longest = _MANOEUVRES[self._manoeuvre]
        self._time_left = float(self._rng.uniform(shortest, longest))
        self._strength, self._side = float(self._rng.random()), float(self._rng.choice((-1.0, 1.0)))
        self._until_next = self._time_left + float(self._rng.exponential(self._pause))
