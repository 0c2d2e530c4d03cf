"""A KITTI drive through the whole pipeline: PCA, dataset, pictures, valid rates by distance, and LiDAR scan alignment.

Scans are transformed by the poses onto later ones; their distance from upright planes there shows whether poses,
motion compensation and stamps are right.

`python -m experiments.kitti ../shared/data/kitti_raw/2011_09_26/2011_09_26_drive_0013_sync --out kitti`

KITTI's drives are too short to be split: all of a drive counts as training (`blocks:1,0,0`).
"""

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import tyro
from jaxtyping import Float
from scipy.spatial import cKDTree

from experiments.command import run
from offpiste.dataset.extract import make_dataset
from offpiste.dataset.fit_pca import fit_pca
from offpiste.dataset.splits import parse_split
from offpiste.logs.measurements import Cloud, Lidar
from offpiste.logs.opening import open_log
from offpiste.logs.poses import Poses
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.perception.backbones import open_backbone
from offpiste.perception.motion_compensation import points_in_world
from offpiste.perception.pca import save_pca
from offpiste.rig.rig import load_rig
from offpiste.visualization.view import view

logger = logging.getLogger("experiments")

VARIANTS = ("by the poses", "sweep not compensated", "stamped 0.2 s late", "not compensated")
"""Variants of the transformation: the right one, and three wrong ones."""
_LATE = 0.2
"""Delay of the wrong stamps [s]."""
_MIN_POINTS = 300
"""Least number of points on upright planes for a comparison of two scans."""


def scan_alignment(
    scans: Sequence[Cloud], lidar: Lidar, poses: Poses, *, apart: int, every: int = 5
) -> Float[np.ndarray, "n 4"]:
    """Median distance from upright planes of a later scan, by `VARIANTS` [m]; NaN where there are too few planes.

    Args:
        apart: number of scans between the two of a pair.
        every: every that many scans begins a pair.
    """
    distances = []
    for one, other in zip(scans[: len(scans) - apart : every], scans[apart::every], strict=False):
        compensated = [_in_world(scan, lidar, poses) for scan in (one, other)]
        uncompensated = [_in_world(replace(scan, offset=None), lidar, poses) for scan in (one, other)]
        late = _in_world(replace(one, time=one.time + _LATE), lidar, poses)
        unmoved = _in_world(replace(one, time=other.time), lidar, poses)
        pairs = (compensated, uncompensated, (late, compensated[1]), (unmoved, compensated[1]))
        distances.append([distance_from_upright_planes(moved[::5], onto[::2]) for moved, onto in pairs])
    return np.array(distances).reshape(-1, len(VARIANTS))


def distance_from_upright_planes(moved: Float[np.ndarray, "n 3"], onto: Float[np.ndarray, "m 3"]) -> float:
    """Median distance of points from planes through upright structure of another scan [m]; NaN where there is little.

    Of each point the nearest one of the other scan within 1 m counts, where its ten neighbours lie on a plane that is
    flat to 5 cm, no line, and not level.
    """
    if len(moved) < _MIN_POINTS or len(onto) < _MIN_POINTS:
        return float("nan")
    tree = cKDTree(onto)
    distance, index = tree.query(moved, distance_upper_bound=1.0)
    moved, index = moved[np.isfinite(distance)], index[np.isfinite(distance)]
    reach, near = tree.query(onto[index], 10)
    patch = onto[near] - onto[near].mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", patch, patch) / 10)
    normal, spread = axes[:, :, 0], spread.clip(0)
    upright = (np.abs(normal[:, 2]) < 0.3) & (spread[:, 0] < 0.05**2) & (spread[:, 1] > 9 * spread[:, 0])
    upright &= reach[:, -1] < 1
    if upright.sum() < _MIN_POINTS:
        return float("nan")
    return float(np.median(np.abs(np.einsum("ni,ni->n", moved - onto[index], normal))[upright]))


def _in_world(scan: Cloud, lidar: Lidar, poses: Poses) -> Float[np.ndarray, "n 3"]:
    points = points_in_world(scan, lidar, poses)
    return points[np.isfinite(points).all(axis=1)]


SPLIT = "blocks:1,0,0"
APART = (1, 2, 5)
"""Numbers of scans between the two of a pair."""


def alignment_table(log: SensorLog) -> str:
    """Table of the alignment of all LiDARs, by distance between scans and by variant."""
    lines = [f"{'from upright planes [m]':22}" + "".join(f"{variant:>24}" for variant in VARIANTS) + "     pairs"]
    for name, lidar in log.lidars.items():
        scans = [scan for scan in log.stream([name]) if isinstance(scan, Cloud)]
        for apart in APART:
            distances = scan_alignment(scans, lidar, log.poses, apart=apart)
            distances = distances[np.isfinite(distances).all(axis=1)]
            if len(distances):
                middle, worst = np.median(distances, axis=0), distances.max(axis=0)
                cells = "".join(f"{m:13.3f} (max {w:.2f})" for m, w in zip(middle, worst, strict=True))
                lines.append(f"{name}, {apart} apart".ljust(22) + cells + f"{len(distances):10}")
    return "\n".join(lines)


def main(drive: tyro.conf.Positional[Path], out: Path = Path("kitti"), backbone: str = "filterbank") -> None:
    """Run a KITTI drive through the pipeline: fit a PCA, extract, draw, and measure how well scans align.

    Args:
        drive: a folder `..._sync` beside its day's calibration files.
        out: folder of pca.safetensors, dataset.zarr, and the pictures in `log` and `dataset`.
        backbone: as in `offpiste fit-pca`.
    """
    rig = load_rig("kitti")
    out.mkdir(parents=True, exist_ok=True)
    pca = out / "pca.safetensors"
    save_pca(pca, fit_pca([drive], rig, parse_split(SPLIT), open_backbone(backbone)).pca)
    dataset = make_dataset([drive], rig, out / "dataset.zarr", split=SPLIT, pca=pca, force=True)
    written = view(drive, out / "log", rig="kitti", pca=pca, rrd=False)
    written += view(dataset.path, out / "dataset")
    logger.info(alignment_table(open_sensors(open_log(drive), rig)))
    logger.info(f"wrote {', '.join(map(str, written))}")


if __name__ == "__main__":
    run(main)
