"""Check of controls that end short of their range: cut off by the recorder, or in another scale.

Presses of a driver end at different values, and the largest of them once. A limit is where many presses end, exactly,
coming from values in between: a switch jumps there, and a lever has few steps. Only at the end of the range (a pedal on
the floor, full lock) is that healthy. Whether the driver pressed further cannot be seen in the channel itself.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.core.channels import CONTROLS
from offpiste.inspection.findings import Finding, Severity
from offpiste.logs.drive import Drive
from offpiste.rig.edits import rescaled

_WHOLE: Final = 0.9
"""A control that reaches this share of its range has it all: stops and trims are not quite at 1."""
_ENDS: Final = 5
"""Presses that end at the limit, at least."""
_CROWDED: Final = 3.0
"""So many times as many presses end there as at each of the values just below."""
_BELOW: Final = 0.8
"""Share of the limit from which a value is just below it."""
_BETWEEN: Final = 0.3
"""Share of the limit from which a value is on the way there: below it a switch may jump."""
_LEVELS: Final = 12
"""Values below the limit, at least: a lever with fewer steps, or keys, end at the same one again and again."""
_ROUNDING: Final = 1e-6


@dataclass(frozen=True)
class Limit:
    """A value at which many presses of a control end.

    Attributes:
        value: largest of the control in this direction.
        presses: that end there.
    """

    value: float
    presses: int


def check_range_ends(drive: Drive) -> list[Finding]:
    """A finding for each control that ends at one value, again and again, well within its range."""
    findings = []
    for control in CONTROLS:
        if control.name not in drive.channels:
            continue
        values = drive.channels[control.name].values[:, 0]
        sides = [values, -values] if control.low < 0 else [values]
        limits = [limit for side in sides if (limit := limit_of(side)) is not None]
        reached = max(float(side.max()) for side in sides)
        if limits and reached < _WHOLE * control.high:
            findings.append(_finding(control.name, limits, drive))
    return findings


def limit_of(values: Float[np.ndarray, " n"]) -> Limit | None:
    """The largest value, if it is where many presses end; None where it is one press's, or a switch's."""
    values = values[np.isfinite(values)]
    first = np.append(0, np.flatnonzero(np.diff(values)) + 1)
    level = values[first]  # of the runs of one value
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
    return Limit(top, count) if count >= _ENDS and at.sum() > _CROWDED * usual else None


def _finding(name: str, limits: list[Limit], drive: Drive) -> Finding:
    value, presses = max(limit.value for limit in limits), sum(limit.presses for limit in limits)
    edits = ", ".join(map(str, rescaled(name, drive.rig.channels[name], 1 / value)))
    what = "ends short of its range: it is cut off, or in another scale"
    at = " and ".join(f"{limit.value:.3g}" for limit in limits)
    evidence = f"{presses} times it ends at exactly {at}, coming from less, and never goes further: the range is 1"
    how = f"record its whole range; or {edits} if that is full {name}"
    # Whoever automates a vehicle holds its brake at one value.
    severity: Severity = "note" if name == "brake" else "warning"
    return Finding(severity, name, what, evidence, how, 0.5)
