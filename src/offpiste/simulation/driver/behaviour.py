"""What a driver feels like doing, without any reason in the ground: speed, cornering, play, and sudden ideas.

A foot on the throttle that hears wheels spin and gives way until they grip.

A wheel that slides on the ground gains speed with whatever torque is too much, so its spin is an integral of the
throttle: a proportional foot holds it, slow enough for its own lag, around a throttle that is found in time.

Getting a vehicle without a reverse gear going again, or giving up.
"""

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


_LAG = 0.1
"""Of the foot [s]."""

_HEARING = 0.05
"""Time over which spin is heard [s]."""

_GAIN, _LEARNING = 0.2, 0.15
"""Throttle given up for spin that is too much [s/m], and how fast that is remembered [1/m]."""

_USUAL, _FORGETTING = 0.8, 2.0
"""Throttle at which wheels are expected to spin, and the time in which it is assumed again once they grip [s]."""


class Foot:
    """Follows the throttle that is asked for."""

    def __init__(self) -> None:
        self._throttle, self._heard, self._held = 0.0, 0.0, _USUAL

    def press(self, asked: float, spin: float, accepted: float) -> float:
        """Throttle after another `DT`.

        Args:
            asked: 0..1.
            spin: how much faster the wheels roll than the vehicle moves [m/s].
            accepted: the spin that is kept to [m/s].
        """
        self._heard += (spin - self._heard) * DT / (_HEARING + DT)
        spare = accepted - self._heard
        most = self._held + _GAIN * spare
        if most < asked:
            self._held = min(max(self._held + _LEARNING * DT * spare, 0.15), 1.0)
        else:
            self._held += (_USUAL - self._held) * DT / _FORGETTING
        self._throttle += (min(asked, max(most, 0.0)) - self._throttle) * DT / (_LAG + DT)
        return self._throttle


_PROGRESS = 2.0
"""Farther away than this, the vehicle has left the place where it stalled [m]."""

_NOTICED = 1.5
"""Time without progress, beyond what the speed in mind would take, until something is done about it [s]."""

_ROUND = 7.0
"""Length of one attempt [s]: dig gently, roll back, charge."""


class Stall:
    """Notices that a vehicle makes no way, and tries what drivers try.

    Args:
        patience: how long [s].
    """

    def __init__(self, timeouts: float) -> None:
        self._patience = timeouts
        self._place: tuple[float, float] | None = None
        self._time = 0.0
        self._clock = 0.0

    @property
    def noticed(self) -> bool:
        """Whether something should be done."""
        return self._time > _NOTICED

    @property
    def hopeless(self) -> bool:
        """Whether it has been tried for long enough."""
        return self._time > self._patience

    def advance(self, x: float, y: float, *, speed: float, at_rest: bool) -> None:
        """Where the vehicle is after another `DT`, how fast [m/s], and whether it is meant to stand."""
        if self._place is None or math.dist((x, y), self._place) > _PROGRESS or (speed > 1.0 and not self.noticed):
            self._place, self._time, self._clock = (x, y), 0.0, 0.0
        elif not at_rest:
            self._time += DT

    def recover(self, speed: float, leans_left: float) -> tuple[float, float, float]:
        """Throttle, spin of the wheels [m/s] to keep to, and steering while no way is made.

        Args:
            speed: forwards [m/s].
            leans_left: slope down to the left, where it is easier to go.
        """
        # What gets going is not interrupted.
        self._clock += DT if speed < 0.25 else 0.0
        phase = self._clock % _ROUND
        towards = min(max(10.0 * leans_left, -1.0), 1.0)
        if phase < 0.6 * _ROUND:
            # Wheels that spin dig themselves in; a little slip pulls best.
            return 1.0, 0.15 + 0.2 * abs(speed), 0.3 * math.sin(2.5 * self._clock)
        if phase < 0.8 * _ROUND:
            # Uphill it rolls back now, for a run-up; steered away from the valley, its nose turns into it.
            return 0.0, 1.0, -0.8 * towards if speed < -0.1 else 0.0
        return 1.0, 2.0, towards
