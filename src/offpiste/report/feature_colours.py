"""Colours of visual features, from their first three components."""

import numpy as np
from jaxtyping import Float, UInt8

PERCENTILES = (2.0, 98.0)
"""Percentiles of each component at the ends of the colour scale."""


def colour_limits(components: Float[np.ndarray, "*P n"]) -> Float[np.ndarray, "2 3"]:
    """Return the values of the first three components at the ends of the colour scale.

    Args:
        components: of all images to compare; NaN without features.
    """
    chosen = components.reshape(-1, components.shape[-1])
    chosen = chosen[np.isfinite(chosen).all(axis=1), :3].astype(np.float64)
    limits = np.zeros((2, 3))
    if len(chosen):
        limits[:, : chosen.shape[1]] = np.percentile(chosen, PERCENTILES, axis=0)
    return limits


def colours(components: Float[np.ndarray, "*P n"], limits: Float[np.ndarray, "2 3"]) -> UInt8[np.ndarray, "*P 3"]:
    """Return the first three components as RGB; missing or constant components are grey, patches with NaN black."""
    low, high = limits
    values = np.zeros((*components.shape[:-1], 3))
    given = min(3, components.shape[-1])
    values[..., :given] = components[..., :given]
    known = np.isfinite(values).all(axis=-1, keepdims=True)
    width = high - low
    shade = np.where(width > 0, (np.where(known, values, 0.0) - low) / np.where(width > 0, width, 1.0), 0.5)
    return np.where(known, np.rint(255 * shade.clip(0, 1)), 0).astype(np.uint8)
