"""Check of the rig's valid ranges, which may drop measurements as well as faults."""

from typing import Final

import msgspec
import numpy as np
from jaxtyping import Bool, Float

from offpiste.inspection.findings import Finding
from offpiste.inspection.ranges import limits
from offpiste.inspection.recorded_log import Recorded
from offpiste.logs.channel import convert, largest
from offpiste.rig.edits import Edit, rounded
from offpiste.rig.rig import Rig

_USUAL: Final = 99.5
"""Percentile of the steps between valid samples."""
_LARGER: Final = 2.0
"""Minimum ratio of a fault's step to that percentile."""
_SHARE: Final = 0.005
"""Minimum reported share of dropped samples."""


def check_dropped(recorded: dict[str, Recorded], rig: Rig) -> list[Finding]:
    """Return a finding for each channel whose `valid` interval drops values continuous with their neighbours."""
    findings = []
    for name, source in rig.channels.items():
        r = recorded.get(source.topic)
        if source.valid is None or r is None or not set(source.fields) <= set(r.fields):
            continue
        columns = r.values[:, [r.fields.index(field) for field in source.fields]]
        values = convert(name, msgspec.structs.replace(source, clip=None), columns, rig.vehicle)
        values = values[(np.abs(np.nan_to_num(values, nan=np.inf)) <= largest(name)).all(axis=1)]
        outside = ((values < source.valid[0]) | (values > source.valid[1])).any(axis=1)
        measured = _continuing(values, outside)
        if measured.sum() <= _SHARE * len(values):
            findings += _mostly(name, outside)
            continue
        reached = values[measured | ~outside]
        low, high = float(reached.min()), float(reached.max())
        span = limits(name)
        if span is not None:  # a control's steps may hide part of it
            low, high = min(low, span[0]), max(high, span[1])
        room = (high - low) / 20
        edit = Edit(f"channels.{name}.valid", [rounded(low - room), rounded(high + room)])
        evidence = f"{measured.sum()} of {len(values)} samples ({measured.mean():.1%}), between "
        evidence += f"{reached.min():.3g} and {reached.max():.3g}, lie outside of {source.valid[0]:g} to "
        evidence += f"{source.valid[1]:g} and continue their neighbours"
        share = float(measured.mean())
        findings.append(Finding("warning", name, "valid drops measurements", evidence, str(edit), share, ((edit,),)))
    return findings


def _mostly(name: str, outside: Bool[np.ndarray, " n"]) -> list[Finding]:
    """Return a note if most samples are dropped: logs may mark unknown values, but rarely so often."""
    share = float(outside.mean()) if len(outside) else 0.0
    if share <= 0.5:
        return []
    evidence = f"{outside.sum()} of {len(outside)} samples ({share:.1%}); rows without them are not complete"
    return [Finding("note", name, "valid drops most samples", evidence, "widen or remove `valid`", share)]


def _continuing(values: Float[np.ndarray, "n k"], outside: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return out-of-range samples in runs without larger steps into, within or out of them than valid samples have."""
    result = np.zeros(len(values), bool)
    if not outside.any() or outside.all():
        return result
    steps = np.abs(np.diff(values, axis=0)).max(axis=1)
    inside = ~outside[1:] & ~outside[:-1]
    if not inside.any():
        return result
    large = steps > _LARGER * float(np.percentile(steps[inside], _USUAL))
    edges = np.flatnonzero(np.diff(np.concatenate(([False], outside, [False]))))
    for first, end in edges.reshape(-1, 2):
        # Step i leads from sample i to i + 1: from the sample before the run to the one after it.
        if not large[max(first - 1, 0) : end].any():
            result[first:end] = True
    return result
