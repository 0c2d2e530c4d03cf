"""Check of topics that are published only when what they say changes, as joysticks and commanded gears are."""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.inspection.findings import Finding
from offpiste.inspection.recorded_log import Recorded
from offpiste.rig.channels import OTHER_CHANNELS
from offpiste.rig.edits import Edit
from offpiste.rig.rig import Rig

_FEW: Final = 30
"""Samples of a topic that tell, at least."""
_NEW: Final = 0.98
"""Share of samples that differ from the one before, at least."""
_SILENCES: Final = 5
"""Intervals longer than `clock.max_gap`, at least ..."""
_SILENT: Final = 0.05
"""... and their share of the time."""
_JUMP: Final = 3.0
"""A topic whose samples are lost has changed by then, this many times as much as from sample to sample."""


def check_on_change(recorded: dict[str, Recorded], rig: Rig) -> list[Finding]:
    """A finding for each topic of controls or actuators that is silent while they stay.

    No sample says again what the one before said, and none of those after a silence says something far from what was
    said before it, as it would be where samples are lost.
    """
    findings = []
    for topic, r in recorded.items():
        reads = {name: source for name, source in rig.channels.items() if source.topic == topic}
        known = [name for name, source in reads.items() if source.interpolation == "on change"]
        if not reads or len(known) == len(reads) or any(name in OTHER_CHANNELS for name in reads):
            continue
        if len(r.time) < _FEW or not np.isfinite(r.time).all():
            continue
        step = np.diff(r.time)
        silence = step > rig.clock.max_gap
        share = float(step[silence].sum() / max(step.sum(), 1e-9))
        if silence.sum() < _SILENCES or share < _SILENT or not (step > 0).all():
            continue
        changed, jumps = _changes(r, silence)
        if changed < _NEW or jumps > _JUMP:
            continue
        cure = tuple(Edit(f"channels.{name}.interpolation", "on change") for name in reads if name not in known)
        what = "is published only when it changes"
        evidence = (
            f"{changed:.0%} of its samples differ from the one before; {silence.sum()} times it is silent for more "
        )
        evidence += f"than {rig.clock.max_gap:g} s, {share:.0%} of the time"
        findings.append(Finding("warning", topic or "table", what, evidence, ", ".join(map(str, cure)), share, (cure,)))
    return findings


def _changes(r: Recorded, silence: Bool[np.ndarray, " n"]) -> tuple[float, float]:
    """Share of samples that differ from the one before; how far after silences, over how far elsewhere.

    Times and counters, which grow with each sample, do not say that something changed.
    """
    values = r.values[:, [bool(np.isfinite(column).all()) and not _grows(column) for column in r.values.T]]
    changes: Float[np.ndarray, "n k"] = np.abs(np.diff(values, axis=0))
    changed = (changes > 0).any(axis=1)
    if not changed.any() or silence.all():
        return 0.0, np.inf
    spread = np.ptp(values, axis=0)
    relative = (changes[:, spread > 0] / spread[spread > 0]).max(axis=1)
    usual = float(np.median(relative[~silence & changed])) if (~silence & changed).any() else 0.0
    return float(changed.mean()), float(np.median(relative[silence])) / max(usual, 1e-9)


def _grows(column: Float[np.ndarray, " n"]) -> bool:
    step = np.diff(column)
    return bool((step >= 0).all() and (step > 0).mean() > 0.5)
