"""What can go wrong with the sensors of a vehicle that drives, on purpose."""

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float32, UInt8

from offpiste.logs.measurements import Cloud, Image
from offpiste.mapping.replay import ExtractFeatures
from offpiste.runtime.runtime import Runtime

Kind = Literal["none", "camera-dropped", "lidar-dropped", "late-image", "nan-features", "map-empty"]
KINDS: tuple[Kind, ...] = get_args(Kind)


@dataclass
class Fault:
    """A fault of the sensors that begins at some moment and stays.

    Attributes:
        start: since the start of the drive [s].
        late: of an image that comes late [s].
    """

    kind: Kind = "none"
    start: float = 10.0
    late: float = 0.8
    _waiting: list[tuple[float, Image]] = field(default_factory=list)
    _now: float = 0.0
    _struck: bool = False

    def passed(self, measured: Image | Cloud | None, time: float) -> list[Image | Cloud]:
        """What arrives at the run time now, with its own stamp."""
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
            # Echoes from nowhere: far beyond the map.
            return [*arrived, replace(measured, points=measured.points + np.array((0.0, 0.0, 1000.0)))]
        return [*arrived, measured]

    def strike(self, runtime: Runtime, time: float) -> None:
        """What the fault does to the run time itself."""
        if self.kind == "map-empty" and time >= self.start and not self._struck:
            self._struck = True
            runtime.forget_map()

    def extractor(self, extract: ExtractFeatures) -> ExtractFeatures:
        """What the backbone gives."""

        def faulty(pixels: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "rows columns F"]:
            features = extract(pixels)
            broken = self.kind == "nan-features" and self._now >= self.start
            return np.full_like(features, np.nan) if broken else features

        return faulty
