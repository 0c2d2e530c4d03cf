"""Times of points as drivers of LiDARs write them: field, type, values of a sweep by its stamp, unit and origin."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

SWEEP = 0.1
"""Of all of them, also the time between scans [s]."""


class PointClock(NamedTuple):
    field: str
    kind: str
    values: Callable[[float, np.ndarray], np.ndarray]
    unit: str
    origin: str

    def fill(self, stamp: float, xyz: np.ndarray) -> np.ndarray:
        """Records of a scan whose points are measured one after the other."""
        points = np.zeros(len(xyz), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), (self.field, self.kind)])
        points["x"], points["y"], points["z"] = np.asarray(xyz, np.float32).T
        points[self.field] = self.values(stamp, np.linspace(0, SWEEP, len(xyz), endpoint=False))
        return points

    @property
    def entries(self) -> dict[str, str]:
        """Of the rig."""
        return {"time_field": self.field, "time_unit": self.unit, "time_origin": self.origin}

    def rig_lines(self, **changed: str) -> str:
        return "".join(f'{key} = "{value}"\n' for key, value in (self.entries | changed).items())


DRIVERS = {
    "Ouster": PointClock("t", "<u4", lambda _, since: since * 1e9, "ns", "stamp"),
    "Velodyne": PointClock("time", "<f4", lambda _, since: since, "s", "stamp"),
    "Velodyne, stamped at the end": PointClock("time", "<f4", lambda _, since: since - SWEEP, "s", "stamp"),
    "Hesai": PointClock("timestamp", "<f8", lambda stamp, since: stamp + since, "s", "epoch"),
    "RoboSense, stamped at the end": PointClock(
        "timestamp", "<f8", lambda stamp, since: stamp + since - SWEEP, "s", "epoch"
    ),
    "Livox": PointClock("timestamp", "<f8", lambda stamp, since: (stamp + since) * 1e9, "ns", "epoch"),
    "Livox, offsets": PointClock("offset_time", "<u4", lambda _, since: since * 1e9, "ns", "stamp"),
    "microseconds": PointClock("time_stamp", "<u4", lambda _, since: since * 1e6, "us", "stamp"),
    "milliseconds": PointClock("t", "<f4", lambda _, since: since * 1e3, "ms", "stamp"),
    "microseconds since 1970": PointClock("t", "<f8", lambda stamp, since: (stamp + since) * 1e6, "us", "epoch"),
    "milliseconds since 1970": PointClock("t", "<f8", lambda stamp, since: (stamp + since) * 1e3, "ms", "epoch"),
}
