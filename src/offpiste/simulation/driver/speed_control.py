"""Pedals that keep a slow speed, forwards or in reverse: a proportional and integral controller."""

from offpiste.conventions import DT

_PROPORTIONAL, _INTEGRAL, _MOST = 0.35, 0.4, 0.8
"""Throttle per lack of speed [s/m], its growth [1/m], and the most that it grows to."""

_BRAKE, _TOLERANCE = 0.35, 0.15
"""Brake per excess speed [s/m], and the excess without brake [m/s]."""


class SpeedControl:
    """Throttle and brake from the lack of speed; what the ground demands is learned while it lasts."""

    def __init__(self) -> None:
        self._held = 0.1

    def pedals(self, lack: float) -> tuple[float, float]:
        """Throttle and brake after another `DT`, 0..1.

        Args:
            lack: wanted speed minus speed, both in the direction of the gear [m/s].
        """
        self._held = min(max(self._held + _INTEGRAL * lack * DT, 0.0), _MOST)
        throttle = min(max(self._held + _PROPORTIONAL * lack, 0.0), 1.0)
        brake = min(max(-_BRAKE * (lack + _TOLERANCE), 0.0), 1.0)
        return (0.0, brake) if brake > 0 else (throttle, 0.0)
