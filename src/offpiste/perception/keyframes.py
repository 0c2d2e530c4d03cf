"""Keyframes: images some metres apart and, for the PCA, those most unlike each other."""

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from offpiste.core.errors import PerceptionError


def keyframes_by_travel(position: Float[np.ndarray, "n k"], metres: float) -> Int[np.ndarray, " m"]:
    """Indices of keyframes, each at least `metres` from the one before.

    The straight distance counts: noise in the pose of a parked vehicle adds up to a path, but not to a distance.

    Args:
        position: of the vehicle at each frame's stamp, in the order of time [m]; NaN where it is not known.
        metres: 0 takes every frame whose position is known.

    Returns:
        increasing; it starts with the first frame whose position is known.
    """
    chosen: list[int] = []
    for index in np.flatnonzero(np.isfinite(position).all(axis=1)):
        if not chosen or np.linalg.norm(position[index] - position[chosen[-1]]) >= metres:
            chosen.append(int(index))
    return np.array(chosen, dtype=np.int64)


def image_statistics(image: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, " 14"]:
    """Statistics of ground and light of an RGB image, cheaply.

    They come from its lower two thirds, where the ground is, at 64x32 pixels: mean and spread of lightness and of both
    colours (CIE L*a*b*), each for the nearer and the further half, and the logarithm of the roughness of the lightness.
    """
    ground = image[image.shape[0] // 3 :]
    small = cv2.resize(ground, (64, 32), interpolation=cv2.INTER_AREA)
    lab = cv2.cvtColor(small, cv2.COLOR_RGB2LAB).astype(np.float64)
    statistics: list[float] = []
    for half in (lab[:16], lab[16:]):
        roughness = np.abs(np.diff(half[:, :, 0], axis=1)).mean()
        statistics += [*half.mean(axis=(0, 1)), *half.std(axis=(0, 1)), np.log(roughness + 1.0)]
    return np.array(statistics)


def most_diverse(statistics: Float[np.ndarray, "N k"], count: int, *, seed: int) -> Int[np.ndarray, " n"]:
    """Rows that represent all rows: from a random one, always the one furthest from those chosen.

    Farthest-point sampling (Gonzalez, "Clustering to minimize the maximum intercluster distance", 1985), on columns
    scaled to equal spread.

    Returns:
        n = min(count, N) indices, increasing.

    Raises:
        PerceptionError: no rows, or rows that are not finite.
    """
    if not len(statistics) or not np.isfinite(statistics).all():
        raise PerceptionError("no images to choose from, or broken ones", how="give a log with images")
    spread = statistics.std(axis=0)
    scaled = (statistics - statistics.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    chosen = [int(np.random.default_rng(seed).integers(len(scaled)))]
    apart = np.full(len(scaled), np.inf)
    while len(chosen) < min(count, len(scaled)):
        apart = np.minimum(apart, np.linalg.norm(scaled - scaled[chosen[-1]], axis=1))
        apart[chosen] = -1.0
        chosen.append(int(apart.argmax()))
    return np.sort(np.array(chosen, dtype=np.int64))
