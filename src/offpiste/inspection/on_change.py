"""Check for topics that are published only on change, such as joysticks and commanded gears."""

from collections.abc import Mapping, Set
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.core.channels import control_of
from offpiste.inspection.findings import Finding
from offpiste.inspection.recorded_log import Recorded
from offpiste.rig.channels import OTHER_CHANNELS, ChannelSource
from offpiste.rig.edits import Edit
from offpiste.rig.rig import Rig

WHAT: Final = "is published only when it changes"
_FEW: Final = 30
"""Minimum number of samples of a non-discrete channel for a decision."""
_NEW: Final = 0.98
"""Minimum share of samples that differ from the previous sample."""
_SILENCES: Final = 5
"""Minimum number of intervals longer than `clock.max_gap`."""
_SILENT: Final = 0.05
"""Minimum share of the time in such intervals."""
_JUMP: Final = 3.0
"""Maximum ratio of the change across silences to the usual change; lost samples cause larger changes."""


def check_on_change(recorded: dict[str, Recorded], rig: Rig) -> list[Finding]:
    """Return a finding for each control or actuator topic that is silent while its values are constant."""
    findings = []
    for topic, r in recorded.items():
        reads = {name: source for name, source in rig.channels.items() if source.topic == topic}
        changing = [name for name, source in reads.items() if source.interpolation != "on change"]
        measured = any(name in OTHER_CHANNELS for name in reads)
        if not changing or measured or not _is_on_change(r, reads, rig.clock.max_gap):
            continue
        step = np.diff(r.time)
        silence = step > rig.clock.max_gap
        share = float(step[silence].sum() / max(step.sum(), 1e-9))
        evidence = f"{len(r.time)} samples, {_changed(r):.0%} of them new; {silence.sum()} times it is silent for more "
        evidence += f"than {rig.clock.max_gap:g} s, {share:.0%} of the time"
        cure = tuple(Edit(f"channels.{name}.interpolation", "on change") for name in changing)
        remedy = ", ".join(map(str, cure))
        findings.append(Finding("warning", topic or "table", WHAT, evidence, remedy, share, (cure,)))
    return findings


def _is_on_change(r: Recorded, reads: Mapping[str, ChannelSource], max_gap: float) -> bool:
    """Return whether all samples differ from the previous sample and no value jumps after a silence.

    Values that follow lost samples differ strongly from those before.
    """
    if not np.isfinite(r.time).all() or _changed(r) < _NEW:
        return False
    step = np.diff(r.time)
    silence = step > max_gap
    if all((control := control_of(name)) is not None and control.discrete for name in reads):
        return bool(silence.all())
    often = len(r.time) >= _FEW and silence.sum() >= _SILENCES and step[silence].sum() >= _SILENT * step.sum()
    fields = {field for source in reads.values() for field in source.fields}
    return bool((step > 0).all()) and bool(often) and _jumps(r, fields, silence) <= _JUMP


def _changed(r: Recorded) -> float:
    """Return the share of samples that differ from the previous one, ignoring times and counters."""
    values = r.values[:, [bool(np.isfinite(column).all()) and not _grows(column) for column in r.values.T]]
    return float((np.diff(values, axis=0) != 0).any(axis=1).mean()) if len(values) > 1 else 1.0


def _jumps(r: Recorded, fields: Set[str], silence: Bool[np.ndarray, " n"]) -> float:
    """Return the ratio of the median change of fields across silences to their usual change."""
    values = r.values[:, [field in fields for field in r.fields]]
    spread = np.ptp(values, axis=0)
    moves = spread > 0
    if not moves.any():
        return np.inf
    change = (np.abs(np.diff(values[:, moves], axis=0)) / spread[moves]).max(axis=1)
    usual = change[~silence & (change > 0)]
    return float(np.median(change[silence])) / float(np.median(usual)) if len(usual) else np.inf


def _grows(column: Float[np.ndarray, " n"]) -> bool:
    step = np.diff(column)
    return len(step) > 2 and bool((step >= 0).all() and (step > 0).mean() > 0.5)
