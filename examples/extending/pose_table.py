"""A viewer from outside: `offpiste live … --view pose-table` writes where the vehicle is to a table.

    OFFPISTE_EXTENSIONS=pose_table PYTHONPATH=examples/extending offpiste live my.toml … --view pose-table

A file like this one in `src/offpiste/live/viewers/` is found by itself.
"""

from pathlib import Path

import numpy as np

from offpiste.live.viewers import VIEWERS, Viewer
from offpiste.runtime.estimator import VehicleReading


@VIEWERS.register("pose-table")
class PoseTable(Viewer):
    """Writes time, x and y to a table; what it does not override is not shown."""

    package = ""

    def __init__(self, place: str, wheels: np.ndarray, cameras: tuple[str, ...]) -> None:
        self._file = Path(place or "poses.csv").open("w", encoding="utf-8")  # noqa: SIM115 - `close` does
        self._file.write("time,x,y\n")
        self.where = self._file.name

    def pose(self, reading: VehicleReading) -> None:
        """Add a row, which can be read at once."""
        x, y, _ = reading.position
        self._file.write(f"{reading.time:.2f},{x:.2f},{y:.2f}\n")
        self._file.flush()

    def close(self) -> None:
        """Close the table."""
        self._file.close()
