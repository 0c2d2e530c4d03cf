"""Traction control."""

from offpiste.conventions import DT

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
