"""The first three components of visual features as colours."""

import numpy as np
from jaxtyping import Bool, Float, UInt8

PERCENTILES = (2.0, 98.0)
"""Percentiles of each component that are drawn darkest and brightest."""


def colour_limits(
    components: Float[np.ndarray, "*P n"], mask: Bool[np.ndarray, "*P"] | None = None
) -> Float[np.ndarray, "2 3"]:
    """Values of the first three components that are drawn darkest and brightest.

    Args:
        components: of one image, or of all that are to be compared; NaN where there are none.
        mask: patches that count, e.g. ground.
    """
    chosen = components.reshape(-1, components.shape[-1]) if mask is None else components[mask]
    chosen = chosen[np.isfinite(chosen).all(axis=1), :3].astype(np.float64)
    limits = np.zeros((2, 3))
    if len(chosen):
        limits[:, : chosen.shape[1]] = np.percentile(chosen, PERCENTILES, axis=0)
    return limits


def colours(
    components: Float[np.ndarray, "*P n"], limits: Float[np.ndarray, "2 3"] | None = None
) -> UInt8[np.ndarray, "*P 3"]:
    """First three components as RGB; grey for components that are missing or constant, black where one is NaN."""
    low, high = colour_limits(components) if limits is None else limits
    values = np.zeros((*components.shape[:-1], 3))
    given = min(3, components.shape[-1])
    values[..., :given] = components[..., :given]
    known = np.isfinite(values).all(axis=-1, keepdims=True)
    width = high - low
    shade = np.where(width > 0, (np.where(known, values, 0.0) - low) / np.where(width > 0, width, 1.0), 0.5)
    return np.where(known, np.rint(255 * shade.clip(0, 1)), 0).astype(np.uint8)
