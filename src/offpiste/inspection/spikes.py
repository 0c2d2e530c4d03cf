"""Isolated spikes: samples that leave their neighbours and come back."""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import median_filter

_SPIKE: Final = 8.0
"""A spike stands out from its neighbours by this many times what 95 % of the samples do."""
MAX_SPIKES: Final = 0.02
"""More than this share of the samples are no isolated spikes."""


def find_spikes(values: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Samples that leave their neighbours for one or two samples and come back; values are finite.

    They stand out from the running median of seven by `_SPIKE` times what 95 % of the samples do, and by more than
    half of what the middle 99 % of all values span, or of the others: bumps and switched signals do not.
    """
    none = np.zeros(len(values), dtype=bool)
    if len(values) < 50 or len(np.unique(values[:: max(len(values) // 1000, 1)])) <= 4:
        return none
    away = np.abs(values - median_filter(values, 7, mode="mirror"))
    apart = away > _SPIKE * np.percentile(away, 95)
    # Many spikes would be part of what all values span: then what the others span counts.
    spikes: Bool[np.ndarray, " n"] = none
    for usual in (values, values[~apart]):
        spikes = apart & (away > _half_span(usual))
        if spikes.any():
            break
    # The largest hide the others, which are as plain if no usual value is like them.
    while (more := apart & (away > _half_span(values[~spikes]))).sum() > spikes.sum():
        low, high = values[~more].min(), values[~more].max()
        if ((values[more] >= low) & (values[more] <= high)).any():
            break
        spikes = more
    return spikes if 0 < spikes.mean() <= MAX_SPIKES else none


def _half_span(values: Float[np.ndarray, " n"]) -> float:
    """Half of what the middle 99 % of some values span; infinite for none."""
    return float(np.ptp(np.percentile(values, (0.5, 99.5)))) / 2 if len(values) else np.inf
