"""Selection of images by travelled distance and by diversity."""

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from offpiste.core.errors import PerceptionError


def keyframes_by_travel(position: Float[np.ndarray, "n k"], metres: float) -> Int[np.ndarray, " m"]:
    """Return indices of frames with a position [m], each at least `metres` in a straight line from the previous one."""
    chosen: list[int] = []
    for index in np.flatnonzero(np.isfinite(position).all(axis=1)):
        if not chosen or np.linalg.norm(position[index] - position[chosen[-1]]) >= metres:
            chosen.append(int(index))
    return np.array(chosen, dtype=np.int64)


def image_statistics(image: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, " 14"]:
    """Return statistics of ground and light of an RGB image.

    They are computed from its lower two thirds at 64x32 pixels: mean and standard deviation of lightness and both
    colours (CIE L*a*b*), and the logarithm of the lightness's roughness, for the farther and the nearer half.
    """
    small = cv2.resize(image[image.shape[0] // 3 :], (64, 32), interpolation=cv2.INTER_AREA)
    lab = cv2.cvtColor(small, cv2.COLOR_RGB2LAB).astype(np.float64)
    statistics: list[float] = []
    for half in (lab[:16], lab[16:]):
        roughness = np.abs(np.diff(half[:, :, 0], axis=1)).mean()
        statistics += [*half.mean(axis=(0, 1)), *half.std(axis=(0, 1)), np.log(roughness + 1.0)]
    return np.array(statistics)


def most_diverse(statistics: Float[np.ndarray, "N k"], count: int, *, seed: int) -> Int[np.ndarray, " n"]:
    """Return n = min(count, N) increasing indices of diverse rows by farthest-point sampling from a random row.

    Gonzalez, "Clustering to minimize the maximum intercluster distance", 1985, on columns scaled to equal spread.
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
