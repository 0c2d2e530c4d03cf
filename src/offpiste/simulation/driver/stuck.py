"""Stuck recovery."""

import math

from offpiste.conventions import DT

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
