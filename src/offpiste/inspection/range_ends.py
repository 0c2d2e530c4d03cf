"""Check for controls that end short of their range: clipped by the recorder or in another scale.

The peaks of a driver's presses differ, and the largest occurs once. At a limit, many presses end at exactly the same
value after passing values in between (switches jump, and levers have few steps). Such a limit is a fault unless it is
the end of the range, e.g. full lock. The channel alone cannot show whether the driver pressed further.
"""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.core.channels import CONTROLS
from offpiste.inspection.findings import Finding, Severity
from offpiste.logs.drive import Drive
from offpiste.rig.edits import rescaled

_WHOLE: Final = 0.9
"""Minimum share of its range that a fault-free control reaches; stops and trims may be slightly below 1."""
_ENDS: Final = 5
"""Minimum number of presses that end at the limit."""
_CROWDED: Final = 3.0
"""Minimum ratio of the presses that end at the limit to the mean per value just below it."""
_BELOW: Final = 0.8
"""Minimum share of the limit of a value just below it."""
_BETWEEN: Final = 0.3
"""Minimum share of the limit of a value on the way to it; switches jump from below."""
_LEVELS: Final = 12
"""Minimum number of values below the limit; levers with fewer steps and keys repeat the same peak."""
_ROUNDING: Final = 1e-6


def check_range_ends(drive: Drive) -> list[Finding]:
    """Return a finding for each control that repeatedly ends at the same value well within its range."""
    findings = []
    for control in CONTROLS:
        if control.name not in drive.channels:
            continue
        values = drive.channels[control.name].values[:, 0]
        sides = [values, -values] if control.low < 0 else [values]
        limits = [limit for side in sides if (limit := _limit(side)) is not None]
        reached = max(float(side.max()) for side in sides)
        if limits and reached < _WHOLE * control.high:
            findings.append(_finding(control.name, limits, drive))
    return findings


def _limit(values: Float[np.ndarray, " n"]) -> tuple[float, int] | None:
    """Return the maximum and the number of presses that end there; None for a few presses or a switch."""
    values = values[np.isfinite(values)]
    first = np.append(0, np.flatnonzero(np.diff(values)) + 1)
    level = values[first]  # one per run of equal values
    if len(level) < 3 or level.max() <= 0:
        return None
    before, after = level[:-2], level[2:]
    if len(np.unique(level[(level > 0) & (level < level.max())])) < _LEVELS:
        return None
    ends = level[1:-1]
    peak = (ends > before) & (ends > after)
    top = float(level.max())
    at: Bool[np.ndarray, " r"] = peak & (ends >= top * (1 - _ROUNDING))
    below = ends[peak & ~at & (ends >= _BELOW * top)]
    usual = len(below) / max(len(np.unique(below)), 1)
    on_the_way = at & (np.maximum(before, after) > _BETWEEN * top)
    count = int(on_the_way.sum())
    return (top, count) if count >= _ENDS and at.sum() > _CROWDED * usual else None


def _finding(name: str, limits: list[tuple[float, int]], drive: Drive) -> Finding:
    values, presses = zip(*limits, strict=True)
    value = max(values)
    edits = ", ".join(map(str, rescaled(name, drive.rig.channels[name], 1 / value)))
    what = "ends short of its range: it is cut off, or in another scale"
    at = " and ".join(f"{value:.3g}" for value in values)
    evidence = f"{sum(presses)} times it ends at exactly {at}, coming from less, and never goes further: the range is 1"
    how = f"record its whole range; or {edits} if that is full {name}"
    # Automation holds a brake at a constant value.
    severity: Severity = "note" if name == "brake" else "warning"
    return Finding(severity, name, what, evidence, how, 0.5)
