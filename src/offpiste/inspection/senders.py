"""Check for topics with several senders, recognised by alternating values."""

from collections.abc import Collection, Mapping
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.inspection.findings import Finding
from offpiste.inspection.recorded_log import Recorded
from offpiste.rig.rig import Rig

_BEFORE: Final = 4
"""Number of previous samples among which the nearest belongs to the same sender."""
_TURNS: Final = 0.3
"""Minimum share of samples of alternating senders that continue a sample before the last."""
_NEARER: Final = 0.1
"""Maximum distance to the continued sample, as a share of the distance to the last one."""
_LARGE, _LARGE_STEP = 0.1, 0.002
"""Minimum distance to the last sample, as a share of the range of values; of the extent of the path for positions."""


def check_senders(recorded: Mapping[str, Recorded], rig: Rig | None, *, used: Collection[str]) -> list[Finding]:
    """Report topics with several senders.

    Args:
        used: topics that the rig reads.
    """
    findings = []
    for name, r in recorded.items():
        if rig is not None and name in used and (share := _alternating(r, rig)) > _TURNS:
            what = "has several senders: its values alternate between two series"
            evidence = f"{share:.0%} of its samples continue one before the last, and lie far from the last"
            how = "stop one of the senders, or give it a topic of its own, and record it again"
            findings.append(Finding("fatal", name, what, evidence, how, 1.0))
    return findings


def _alternating(topic: Recorded, rig: Rig) -> float:
    """Return the largest share of samples, over a topic's channels, closer to an earlier sample than to the last."""
    shares = [0.0]
    for name, source in rig.channels.items():
        if source.topic == topic.topic.name and topic.has(source):
            values = topic.columns(source)
            values = values[np.isfinite(values).all(axis=1)]
            if name == "orientation":  # a quaternion and its negative are equal
                values = np.einsum("ni,nj->nij", values, values).reshape(len(values), -1)
            shares.append(_turns(values, _LARGE_STEP if name == "position" else _LARGE))
    return max(shares)


def _turns(values: Float[np.ndarray, "n k"], least: float) -> float:
    if len(values) < 20 * _BEFORE:
        return 0.0
    away = [np.linalg.norm(values[_BEFORE:] - values[_BEFORE - k : -k], axis=1) for k in range(1, _BEFORE + 1)]
    last, earlier = away[0], np.min(away[1:], axis=0)
    spread = float(np.linalg.norm(np.subtract(*np.percentile(values, (95, 5), axis=0))))
    return float(np.mean((last > least * spread) & (earlier < _NEARER * last)))
