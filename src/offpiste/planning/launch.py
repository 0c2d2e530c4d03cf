"""Driving off: more throttle than was planned, while the vehicle hardly moves though it was to drive.

Models learn from windows that start above `conventions.MIN_JUDGED_SPEED`, and expect a standing vehicle to follow any
throttle. A torque that does not overcome the resistance of soft ground moves nothing, however often it is planned anew.
"""

from copy import copy
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from offpiste.conventions import DT


@dataclass(frozen=True)
class LaunchSettings:
    """When and how fast.

    Attributes:
        below: the vehicle hardly moves [m/s].
        rate: the throttle rises above the planned one, and comes back to it [1/s].
        wanted: the least planned throttle that is meant to drive.
    """

    below: float = 1.0
    rate: float = 0.3
    wanted: float = 0.05


class Launch:
    """Remembers how much more throttle is given than was planned."""

    def __init__(self, settings: LaunchSettings | None = None) -> None:
        self._settings = settings or LaunchSettings()
        self._more = 0.0

    def throttle(self, planned: float, speed: float) -> float:
        """What is given for the next `conventions.DT`; never less than was planned.

        Args:
            planned: [0..1].
            speed: over the ground [m/s].
        """
        settings = self._settings
        if planned < settings.wanted:
            self.reset()
            return planned
        rise = settings.rate * DT * (1 if speed < settings.below else -1)
        self._more = min(max(self._more + rise, 0.0), 1.0 - planned)
        return planned + self._more

    def ahead(self, planned: Float[np.ndarray, " N"], speed: float) -> Float[np.ndarray, " N"]:
        """What will be given for steps to come, while the speed stays on its side of `LaunchSettings.below`."""
        later = copy(self)
        return np.array([later.throttle(float(throttle), speed) for throttle in planned])

    def reset(self) -> None:
        """Give what is planned: it begins anew."""
        self._more = 0.0
