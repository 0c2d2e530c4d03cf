"""Ages of what control depends on, by the steady clock: no message sets it, and it never stands still.

Ages by the stamps are right as long as the robot's clock is. One that is frozen makes the newest plan and the last scan
look fresh for ever.
"""

from collections import deque

import numpy as np

from offpiste.runtime.follower import MapState, TimedPlan
from offpiste.runtime.modes import Ages


class SteadyAges:
    """Since when nothing new has come."""

    def __init__(self) -> None:
        self._seen: dict[str, tuple[float, float]] = {}
        self._starts: deque[tuple[float, float]] = deque(maxlen=32)

    def planned(self, plan: TimedPlan, now: float, steady: float) -> None:
        """A plan was taken.

        Args:
            now: by the robot's clock [s].
            steady: by the steady clock [s].
        """
        self._starts.append((plan.start, steady + plan.start - now))

    def ages(self, came: float, state: MapState, acting: TimedPlan | None, steady: float) -> Ages:
        """Ages by the steady clock.

        Args:
            came: when the last reading of the vehicle came, by this clock [s].
            acting: the plan that is followed.
            steady: this clock [s].
        """
        start = next((at for start, at in self._starts if acting is not None and start == acting.start), -np.inf)
        scan, image = (self._unchanged(name, getattr(state, name), steady) for name in ("scan_time", "image_time"))
        return Ages(state=steady - came, scan=scan, image=image, plan=steady - start)

    def _unchanged(self, name: str, value: float, steady: float) -> float:
        """For how long a stamp has been the same; minus infinity for one that is none."""
        if not np.isfinite(value):
            return -np.inf
        if self._seen.get(name, (np.nan, 0.0))[0] != value:
            self._seen[name] = value, steady
        return steady - self._seen[name][1]
