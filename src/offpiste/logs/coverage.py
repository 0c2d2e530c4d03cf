"""What is wrong with when things were measured, in words: gaps, poses that jump, clocks that drift."""

from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.logs.poses import Poses

_LATE: Final = 1.0
"""A sensor that misses more than this at either end of the drive is reported [s]."""
_BLOCKS: Final = 12
"""Of time; the quickest arrival of each tells the clocks' difference: what delays a message only adds to it."""
_DRIFTS: Final = 0.02
"""Clocks that drift apart by more than this are reported [s]: 0.2 m at 10 m/s."""
DRIFT_LIMIT: Final = 0.2
"""... and by more than this, images and scans are of no use with these poses [s]."""
_OFFSET: Final = 0.5
"""Clocks that differ by more than this are reported [s]; no sensor takes so long to send."""


def jump_note(poses: Poses) -> list[str]:
    """Where poses jump."""
    jumps = poses.jumps
    if not len(jumps):
        return []
    when = ", ".join(f"{before - poses.span[0]:.2f}" for before, _ in jumps[:5]) + (", ..." if len(jumps) > 5 else "")
    times = "once" if len(jumps) == 1 else f"{len(jumps)} times"
    return [f"poses jump {times}, {when} s after they start: the map begins anew there, and no window reaches across"]


def span_notes(name: str, inside: Float[np.ndarray, " n"], span: tuple[float, float]) -> list[str]:
    """Whether a sensor starts late, stops early or pauses.

    Args:
        inside: its stamps within the span of the poses, rising, at least one [s].
    """
    (first, last), notes = span, []
    if inside[0] - first > _LATE:
        notes.append(f"{name}: starts {inside[0] - first:.1f} s after the poses")
    if last - inside[-1] > _LATE:
        notes.append(f"{name}: stops {last - inside[-1]:.1f} s before the poses")
    steps = np.diff(inside)
    if len(steps) and steps.max() > max(_LATE, 5 * np.median(steps)):
        at = inside[int(steps.argmax())] - first
        notes.append(f"{name}: pauses for {steps.max():.1f} s, {at:.1f} s after the poses start")
    return notes


def clock_difference(
    stamps: Float[np.ndarray, " n"],
    arrivals: Float[np.ndarray, " n"],
    pose_stamps: Float[np.ndarray, " m"],
    pose_arrivals: Float[np.ndarray, " m"],
) -> tuple[float, float] | None:
    """By how much a sensor's clock is behind the poses' in the middle of the drive, and how far it drifts in it [s].

    The recorder's clock, on which all messages arrive, is what both are compared with; a line through the quickest
    arrivals of each block of time is the difference. None where there are too few messages to tell.
    """
    start = max(arrivals.min(), pose_arrivals.min()) if min(len(stamps), len(pose_stamps)) else 0.0
    end = min(arrivals.max(), pose_arrivals.max()) if min(len(stamps), len(pose_stamps)) else 0.0
    if not end > start:
        return None
    edges = np.linspace(start, end, _BLOCKS + 1)
    own, poses = (_quickest(a, a - s, edges) for s, a in ((stamps, arrivals), (pose_stamps, pose_arrivals)))
    apart, middle = own - poses, (edges[1:] + edges[:-1]) / 2 - (start + end) / 2
    known = np.isfinite(apart)
    if known.sum() < _BLOCKS // 2:
        return None
    slope, offset = np.polyfit(middle[known], apart[known], 1)
    return float(offset), float(slope * (end - start))


def clock_note(name: str, offset: float, drift: float) -> list[str]:
    """What that says of a sensor."""
    if abs(drift) > _DRIFTS:
        return [f"{name}: its stamps drift against the poses' by {1000 * abs(drift):.0f} ms over the drive"]
    if abs(offset) > _OFFSET:
        before = "before" if offset > 0 else "after"
        return [f"{name}: stamped {abs(offset):.2f} s {before} poses that arrive with it; mend its clock or its delay"]
    return []


def _quickest(
    arrivals: Float[np.ndarray, " n"], delay: Float[np.ndarray, " n"], edges: Float[np.ndarray, " e"]
) -> Float[np.ndarray, " b"]:
    block = np.clip(np.searchsorted(edges, arrivals, side="right") - 1, 0, len(edges) - 2)
    inside = (arrivals >= edges[0]) & (arrivals <= edges[-1])
    least = np.full(len(edges) - 1, np.inf)
    np.minimum.at(least, block[inside], delay[inside])
    return np.where(np.isfinite(least), least, np.nan)
