"""Faults of the sensors, injected into a drive: messages lost or late, features or scans broken."""

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from offpiste.logs.measurements import Cloud, Image
from offpiste.mapping.replay import ExtractFeatures
from offpiste.runtime.runtime import Runtime

Kind = Literal["none", "camera-dropped", "lidar-dropped", "late-image", "nan-features", "map-empty"]
KINDS: tuple[Kind, ...] = get_args(Kind)


@dataclass
class Fault:
    """Fault of the sensors that begins at some moment and stays.

    Attributes:
        start: time from the start of the drive [s].
        late: delay of late images [s].
    """

    kind: Kind = "none"
    start: float = 10.0
    late: float = 0.8
    _waiting: list[tuple[float, Image]] = field(default_factory=list)
    _now: float = 0.0
    _struck: bool = False

    def passed(self, measured: Image | Cloud | None, time: float) -> list[Image | Cloud]:
        """Messages that reach the run time now, with their own stamps."""
        self._now = time
        arrived: list[Image | Cloud] = []
        while self._waiting and self._waiting[0][0] <= time + 1e-6:  # sums of tenths are not tenths
            arrived.append(self._waiting.pop(0)[1])
        if measured is None:
            return arrived
        if time < self.start:
            return [*arrived, measured]
        if isinstance(measured, Image):
            if self.kind == "camera-dropped":
                return arrived
            if self.kind == "late-image":
                self._waiting.append((time + self.late, measured))
                return arrived
        elif self.kind == "lidar-dropped":
            return arrived
        elif self.kind == "map-empty":
            # Echoes far above the map.
            return [*arrived, replace(measured, points=measured.points + np.array((0.0, 0.0, 1000.0)))]
        return [*arrived, measured]

    def strike(self, runtime: Runtime, time: float) -> None:
        """Apply the fault to the run time itself: an empty map is empty at once."""
        if self.kind == "map-empty" and time >= self.start and not self._struck:
            self._struck = True
            runtime.forget_map()

    def extractor(self, extract: ExtractFeatures) -> ExtractFeatures:
        """Feature extractor with the fault."""

        def faulty(pixels: np.ndarray) -> np.ndarray:
            features = extract(pixels)
            broken = self.kind == "nan-features" and self._now >= self.start
            return np.full_like(features, np.nan) if broken else features

        return faulty
