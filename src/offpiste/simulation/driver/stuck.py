"""Detecting that a vehicle is stuck, getting it going again without a reverse gear, or giving up."""

import math

from offpiste.core.conventions import DT

_PROGRESS = 2.0
"""Distance after which the vehicle has left the place where it got stuck [m]."""

_DETECTION_TIME = 1.5
"""Time without progress after which the vehicle counts as stuck [s]."""

_ATTEMPT = 7.0
"""Length of one attempt [s]: dig gently, roll back, charge."""


class StuckRecovery:
    """Notices that a vehicle makes no progress, and tries what drivers try.

    Args:
        timeout: time after which it gives up [s].
    """

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self._place: tuple[float, float] | None = None
        self._time = 0.0
        self._attempt_time = 0.0

    @property
    def stuck(self) -> bool:
        """Whether the vehicle makes no progress, and should be recovered."""
        return self._time > _DETECTION_TIME

    @property
    def timed_out(self) -> bool:
        """Whether recovery has taken too long."""
        return self._time > self._timeout

    def advance(self, x: float, y: float, *, speed: float, stop_intended: bool) -> None:
        """Take in the vehicle's position [m] and speed [m/s] after another `DT`."""
        if self._place is None or math.dist((x, y), self._place) > _PROGRESS or (speed > 1.0 and not self.stuck):
            self._place, self._time, self._attempt_time = (x, y), 0.0, 0.0
        elif not stop_intended:
            self._time += DT

    def recover(self, speed: float, leans_left: float) -> tuple[float, float, float]:
        """Throttle, allowed spin of the wheels [m/s], and steering while the vehicle is stuck.

        Args:
            speed: forwards [m/s].
            leans_left: slope down to the left, where it is easier to drive.
        """
        # A vehicle that begins to move is not interrupted.
        self._attempt_time += DT if speed < 0.25 else 0.0
        phase = self._attempt_time % _ATTEMPT
        downhill = min(max(10.0 * leans_left, -1.0), 1.0)
        if phase < 0.6 * _ATTEMPT:
            # Wheels that spin dig themselves in; a little slip pulls best.
            return 1.0, 0.15 + 0.2 * abs(speed), 0.3 * math.sin(2.5 * self._attempt_time)
        if phase < 0.8 * _ATTEMPT:
            # Uphill it rolls back now, for a run-up; steered away from the valley, its nose turns into it.
            return 0.0, 1.0, -0.8 * downhill if speed < -0.1 else 0.0
        return 1.0, 2.0, downhill
