"""Times of a cloud's points as the rig reads them, and whether that can be: a sweep lies about its cloud's stamp."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from jaxtyping import Float, Shaped

from offpiste.logs.log import RawCloud
from offpiste.rig.channels import SECONDS_PER_UNIT
from offpiste.rig.sensors import TIME_FIELDS, LidarSource

SWEEP: Final = 1.0
"""Points lie within this of their cloud's stamp [s]: no LiDAR takes longer for a sweep."""
_SHORTEST: Final = 0.002
"""Least part of the time between scans that a scan takes: a unit that is 1000 times too small makes it shorter."""
_USUAL: Final = 0.1
"""Time between scans where it is not known [s]."""
_SAMPLE: Final = 1000
"""Points of a cloud that are looked at."""
_ORIGINS: Final = {"stamp": "the stamp", "epoch": "1970"}


@dataclass(frozen=True)
class MisreadTimes:
    """Point times that are inconsistent with the rig.

    Attributes:
        what: the fault, in words.
        entries: of the LiDAR in the rig, which make the times fit; empty where no unit and origin do.
    """

    what: str
    entries: dict[str, str]

    def remedy(self, name: str) -> str:
        """Lines of the rig that correct it."""
        if self.entries:
            return lines(name, self.entries)
        return f"remove lidars.{name}.time_field, or record with the LiDAR's clock and its stamps synchronised"


def lines(name: str, entries: dict[str, str]) -> str:
    """Entries of a LiDAR as lines of the rig."""
    return "; ".join(f'lidars.{name}.{key} = "{value}"' for key, value in entries.items())


def offsets(time: float, values: Shaped[np.ndarray, " n"], unit: str, origin: str) -> Float[np.ndarray, " n"]:
    """Time of each point after its cloud's stamp [s].

    Args:
        time: stamp of the cloud.
        values: of the points' field of times.
    """
    seconds = values.astype(np.float64) * SECONDS_PER_UNIT[unit]
    return seconds - time if origin == "epoch" else seconds


def misread_times(raw: RawCloud, source: LidarSource, period: float = 0.0) -> MisreadTimes | None:
    """What is wrong with the times of a cloud's points by the rig; None where nothing is.

    Args:
        period: time between scans; 0 where it is not known [s].
    """
    values = _sample(raw, source.time_field)
    middle, span = _extent(offsets(raw.time, values, source.time_unit, source.time_origin))
    if _fits(middle, span, period):
        return None
    fits = next(_fitting(raw.time, values, period), None)
    read = f"'{source.time_field}', read in {source.time_unit} since {_ORIGINS[source.time_origin]}"
    if abs(middle) > SWEEP:
        what = f"{read}, puts points {abs(middle):.3g} s from their scan's stamp"
    else:
        what = f"{read}, takes {span:.2g} s for scans that come every {period:.2g} s"
    if fits is None:
        return MisreadTimes(f"{what}, and no other unit or origin fits", {})
    now = {"time_unit": source.time_unit, "time_origin": source.time_origin}
    entries = dict(zip(now, fits, strict=True))
    return MisreadTimes(what, {key: value for key, value in entries.items() if value != now[key]})


def proposed_times(raw: RawCloud, period: float = 0.0) -> dict[str, str]:
    """Entries of a LiDAR in the rig that read its points' times; none where no field with a usual name can be such."""
    for field in TIME_FIELDS:
        values = _sample(raw, field)
        moving = _extent(values.astype(np.float64))[1] > 0  # others are compensated already, or not filled in
        fits = next(_fitting(raw.time, values, period), None) if moving else None
        if fits is not None:
            return {"time_field": field, "time_unit": fits[0], "time_origin": fits[1]}
    return {}


def _fitting(time: float, values: Shaped[np.ndarray, " n"], period: float) -> Iterator[tuple[str, str]]:
    """Units and origins by which the points of a scan lie about its stamp."""
    for origin, unit in product(_ORIGINS, ("s", "ms", "us", "ns")):
        if _fits(*_extent(offsets(time, values, unit, origin)), period or _USUAL):
            yield unit, origin


def _fits(middle: float, span: float, period: float) -> bool:
    return abs(middle) <= SWEEP and not 0 < span < _SHORTEST * period


def _extent(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Median, and what most values span; zeros where there are none."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, 0.0
    low, middle, high = np.quantile(finite, (0.05, 0.5, 0.95))
    return float(middle), float(high - low)


def _sample(raw: RawCloud, field: str) -> Shaped[np.ndarray, " n"]:
    """Times of some points that have an echo: drivers leave those of others at zero. None where a field is missing."""
    if not {field, *"xyz"} <= set(raw.points.dtype.names or ()):
        return np.empty(0)
    points = raw.points[:: max(1, len(raw.points) // _SAMPLE)]
    distance = np.abs(points["x"]) + np.abs(points["y"]) + np.abs(points["z"])
    return np.asarray(points[field][np.isfinite(distance) & (distance > 0)])
