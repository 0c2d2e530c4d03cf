"""Which readings and stamps are taken: what is not finite, repeats, goes back or comes from the future is counted."""

from collections import Counter
from collections.abc import Collection
from typing import Literal

import numpy as np

from offpiste.rig.outputs import Timeouts
from offpiste.runtime.estimator import VehicleReading, VehicleTrack


class Intake:
    """Adds readings to a track.

    Args:
        actuators: that the model reads.
        dropped: number of messages that were dropped, by reason; it is counted on.

    Attributes:
        now: the clock [s]; infinite before it is known.
    """

    def __init__(
        self, track: VehicleTrack, actuators: Collection[str], timeouts: Timeouts, dropped: Counter[str]
    ) -> None:
        self._track, self._timeouts, self.dropped = track, timeouts, dropped
        self._needed = tuple(actuators)
        self.now = np.inf

    def vehicle(self, reading: VehicleReading) -> Literal["dropped", "taken", "jumped"]:
        """Add a reading; "jumped" where the pose did, so that the map so far no longer fits."""
        latest = self._track.latest
        if self.ahead("readings of the vehicle", reading.time):
            return "dropped"
        if not reading.finite:
            self.dropped["readings of the vehicle that are not finite"] += 1
            return "dropped"
        known = np.isfinite(reading.measured(self._needed))
        if lacks := [name for name, is_known in zip(self._needed, known, strict=True) if not is_known]:
            self.dropped[f"readings of the vehicle without {', '.join(lacks)}, which the model reads"] += 1
            return "dropped"
        if latest is not None and reading.time <= latest.time:
            self.dropped["readings of the vehicle whose stamps repeat or go back"] += 1
            return "dropped"
        return "jumped" if self._track.add(reading) else "taken"

    def ahead(self, what: str, time: float) -> bool:
        """Whether a stamp is ahead of the clock, which is counted: after it, all later messages would count as old."""
        ahead = time > self.now + self._timeouts.ahead
        if ahead:
            self.dropped[f"{what}: stamps ahead of the clock"] += 1
        return ahead
