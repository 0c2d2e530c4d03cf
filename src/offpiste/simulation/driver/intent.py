"""The random intent."""

import math
from typing import Literal, NamedTuple

import numpy as np

from offpiste.conventions import DT

Idea = Literal["", "throttle", "brake", "coast", "swerve", "brake and swerve", "stop"]

_MEMORY = (7.0, 6.0, 0.7)
"""Correlation times of speed, cornering and play [s]."""

_KEEP = [(math.exp(-DT / memory), math.sqrt(1 - math.exp(-2 * DT / memory))) for memory in _MEMORY]
"""What a step of `DT` keeps, and how much noise makes up for the rest."""

_IDEAS: dict[Idea, tuple[float, float, float]] = {
    "throttle": (0.24, 0.6, 2.0),
    "brake": (0.14, 0.4, 1.4),
    "coast": (0.12, 0.6, 2.0),
    "swerve": (0.28, 0.8, 2.4),
    "brake and swerve": (0.16, 0.6, 1.6),
    "stop": (0.06, 2.0, 5.0),
}
"""Probability, and shortest and longest duration [s]; slowing down is part of a stop."""


class Feeling(NamedTuple):
    """A mood at one moment.

    Attributes:
        speed, cornering, play: Gauss-Markov processes of mean 0 and standard deviation 1.
        idea: what is done for a while, "" most of the time.
        strength: of the idea, 0..1.
        side: of the idea, -1 or 1.
        left: how long the idea still lasts [s].
    """

    speed: float
    cornering: float
    play: float
    idea: Idea
    strength: float
    side: float
    left: float


class Mood:
    """A stream of feelings, one every `DT`.

    Args:
        pause: mean time between ideas [s].
    """

    def __init__(self, rng: np.random.Generator, *, pause: float) -> None:
        self._rng, self._pause = rng, pause
        self._state = rng.standard_normal(3).tolist()
        self._idea: Idea = ""
        self._strength, self._side = 0.0, 1.0
        self._left, self._until_next = 0.0, float(rng.exponential(pause))

    def advance(self) -> Feeling:
        """The next feeling."""
        fresh = self._rng.standard_normal(3).tolist()
        self._state = [k * old + r * new for (k, r), old, new in zip(_KEEP, self._state, fresh, strict=True)]
        self._left -= DT
        self._until_next -= DT
        if self._until_next <= 0:
            self._have_idea()
        elif self._left <= 0:
            self._idea = ""
        speed, cornering, play = self._state
        return Feeling(speed, cornering, play, self._idea, self._strength, self._side, self._left)

    def _have_idea(self) -> None:
        probabilities = [probability for probability, _, _ in _IDEAS.values()]
        self._idea = list(_IDEAS)[int(self._rng.choice(len(_IDEAS), p=probabilities))]
        _, shortest, longest = _IDEAS[self._idea]
        self._left = float(self._rng.uniform(shortest, longest))
        self._strength, self._side = float(self._rng.random()), float(self._rng.choice((-1.0, 1.0)))
        self._until_next = self._left + float(self._rng.exponential(self._pause))
