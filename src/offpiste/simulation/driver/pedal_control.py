"""Pedals of the driver: a slow speed that they keep, and less throttle while the wheels spin too much.

A wheel that slides on the ground accelerates with all torque in excess, so its spin integrates the throttle. A
proportional controller holds it, slowly enough for its own lag, around a throttle that is learned over time.
"""

from offpiste.core.conventions import DT

_PROPORTIONAL, _INTEGRAL, _MOST = 0.35, 0.4, 0.8
"""Throttle per lack of speed [s/m], its growth [1/m], and the most that it grows to."""

_BRAKE, _TOLERANCE = 0.35, 0.15
"""Brake per excess speed [s/m], and the excess without brake [m/s]."""

_LAG = 0.1
"""Time constant of the throttle [s]."""

_SPIN_LAG = 0.05
"""Time constant over which spin is measured [s]."""

_GAIN, _LEARNING_RATE = 0.2, 0.15
"""Throttle given up per excess spin [s/m], and how fast the held throttle is learned [1/m]."""

_USUAL_THROTTLE, _FORGETTING_TIME = 0.8, 2.0
"""Throttle at which wheels are expected to spin, and time constant of the return to it while they grip [s]."""


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


class TractionControl:
    """Follows the requested throttle as far as the wheels' spin permits."""

    def __init__(self) -> None:
        self._throttle, self._spin, self._held = 0.0, 0.0, _USUAL_THROTTLE

    def throttle(self, requested: float, spin: float, allowed_spin: float) -> float:
        """Throttle after another `DT`, 0..1.

        Args:
            requested: requested throttle, 0..1.
            spin: rolling speed of the wheels minus the vehicle's speed [m/s].
            allowed_spin: the spin to keep to [m/s].
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
