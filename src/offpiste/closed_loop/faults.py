"""Faults of the sensors, injected into a drive: messages lost or late, features or scans broken."""

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from offpiste.logs.measurements import Cloud, Image
from offpiste.mapping.replay import ExtractFeatures
from offpiste.runtime.runtime import Runtime

Kind = Literal["none", "camera-dropped", "lidar-dropped", "late-image", "nan-features", "map-empty"]
KINDS: tuple[Kind, ...] = get_args(Kind)
When = Literal["time", "reversing"]
WHENS: tuple[When, ...] = get_args(When)

BACKWARDS = 0.5
"""Rolling speed of the wheels from which the vehicle drives backwards [m/s]."""


@dataclass
class Fault:
    """Fault of the sensors that begins at some moment and stays.

    Attributes:
        start: time from the start of the drive from which it may begin [s].
        when: "time": it begins then; "reversing": it begins when the vehicle next drives backwards.
        late: delay of late images [s].
    """

    kind: Kind = "none"
    start: float = 10.0
    late: float = 0.8
    when: When = "time"
    _waiting: list[tuple[float, Image]] = field(default_factory=list)
    _began: bool = False
    _struck: bool = False

    def notice(self, time: float, rolling: float) -> None:
        """Begin if it is time to.

        Args:
            time: since the start of the drive [s].
            rolling: speed of the wheels, forwards above 0 [m/s].
        """
        self._began |= time >= self.start and (self.when == "time" or rolling < -BACKWARDS)

    def passed(self, measured: Image | Cloud | None, time: float) -> list[Image | Cloud]:
        """Messages that reach the run time now, with their own stamps."""
        arrived: list[Image | Cloud] = []
        while self._waiting and self._waiting[0][0] <= time + 1e-6:  # sums of tenths are not tenths
            arrived.append(self._waiting.pop(0)[1])
        if measured is None:
            return arrived
        if not self._began:
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

    def strike(self, runtime: Runtime) -> None:
        """Apply the fault to the run time itself: an empty map is empty at once."""
        if self.kind == "map-empty" and self._began and not self._struck:
            self._struck = True
            runtime.forget_map()

    def extractor(self, extract: ExtractFeatures) -> ExtractFeatures:
        """Feature extractor with the fault."""

        def faulty(pixels: np.ndarray) -> np.ndarray:
            features = extract(pixels)
            return np.full_like(features, np.nan) if self.kind == "nan-features" and self._began else features

        return faulty
