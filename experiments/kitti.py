"""One scan carried by the poses to another's surroundings: how far it lies off what stands upright there.

A KITTI drive the whole way: PCA, dataset, pictures, valid rates by distance, and scans carried by the poses.

`python -m experiments.kitti ../shared/data/kitti_raw/2011_09_26/2011_09_26_drive_0013_sync --out kitti`

Its drives are too short to be split: all of it counts as training (`blocks:1,0,0`).
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
from offpiste.logs.open import open_log
from offpiste.logs.poses import Poses
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.perception.backbones import open_backbone
from offpiste.perception.motion_compensation import points_in_world
from offpiste.perception.pca import save_pca
from offpiste.rig.rig import load_rig
from offpiste.visualization.view import view

logger = logging.getLogger("experiments")

WAYS = ("by the poses", "sweep not unbent", "stamped 0.2 s late", "not carried")
"""How scans are carried: as they should be, and three ways in which they should not."""
_LATE = 0.2
"""[s]"""
_LEAST = 300
"""Points on upright planes, below which two scans tell nothing."""


def carried_scans(
    scans: Sequence[Cloud], lidar: Lidar, poses: Poses, *, apart: int, every: int = 5
) -> Float[np.ndarray, "n 4"]:
    """Median distance from upright planes of the later scan, by `WAYS` [m]; NaN where there are too few planes.

    Args:
        apart: which later scan each one is carried to.
        every: that scan of the drive begins a pair.
    """
    found = []
    for one, other in zip(scans[: len(scans) - apart : every], scans[apart::every], strict=False):
        unbent = [_in_world(scan, lidar, poses) for scan in (one, other)]
        bent = [_in_world(replace(scan, offset=None), lidar, poses) for scan in (one, other)]
        late = _in_world(replace(one, time=one.time + _LATE), lidar, poses)
        stays = _in_world(replace(one, time=other.time), lidar, poses)
        pairs = (unbent, bent, (late, unbent[1]), (stays, unbent[1]))
        found.append([off_upright_planes(carried[::5], onto[::2]) for carried, onto in pairs])
    return np.array(found).reshape(-1, len(WAYS))


def off_upright_planes(carried: Float[np.ndarray, "n 3"], onto: Float[np.ndarray, "m 3"]) -> float:
    """Median distance of points from planes through upright structure of another scan [m]; NaN where there is little.

    Of each point the nearest one of the other scan within 1 m counts, where its ten neighbours lie on a plane that is
    flat to 5 cm, no line, and not level.
    """
    if len(carried) < _LEAST or len(onto) < _LEAST:
        return float("nan")
    tree = cKDTree(onto)
    distance, index = tree.query(carried, distance_upper_bound=1.0)
    carried, index = carried[np.isfinite(distance)], index[np.isfinite(distance)]
    reach, near = tree.query(onto[index], 10)
    patch = onto[near] - onto[near].mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", patch, patch) / 10)
    normal, spread = axes[:, :, 0], spread.clip(0)
    upright = (np.abs(normal[:, 2]) < 0.3) & (spread[:, 0] < 0.05**2) & (spread[:, 1] > 9 * spread[:, 0])
    upright &= reach[:, -1] < 1
    if upright.sum() < _LEAST:
        return float("nan")
    return float(np.median(np.abs(np.einsum("ni,ni->n", carried - onto[index], normal))[upright]))


def _in_world(scan: Cloud, lidar: Lidar, poses: Poses) -> Float[np.ndarray, "n 3"]:
    points = points_in_world(scan, lidar, poses)
    return points[np.isfinite(points).all(axis=1)]


SPLIT = "blocks:1,0,0"
APART = (1, 2, 5)
"""Scans between which one is carried."""


def carried_table(log: SensorLog) -> str:
    """Distances by how far scans lie apart and by how they are carried, in lines; all LiDARs one after the other."""
    lines = [f"{'off upright planes [m]':22}" + "".join(f"{reading:>20}" for reading in WAYS) + "     pairs"]
    for name, lidar in log.lidars.items():
        scans = [scan for scan in log.stream([name]) if isinstance(scan, Cloud)]
        for apart in APART:
            found = carried_scans(scans, lidar, log.poses, apart=apart)
            found = found[np.isfinite(found).all(axis=1)]
            if len(found):
                middle, worst = np.median(found, axis=0), found.max(axis=0)
                cells = "".join(f"{m:10.3f} (max {w:.2f})" for m, w in zip(middle, worst, strict=True))
                lines.append(f"{name}, {apart} apart".ljust(22) + cells + f"{len(found):10}")
    return "\n".join(lines)


def main(drive: tyro.conf.Positional[Path], out: Path = Path("kitti"), backbone: str = "filterbank") -> None:
    """Fit, extract, draw, measure.

    Args:
        drive: a folder `..._sync` beside its day's calibration files.
        out: for pca.safetensors, dataset.zarr, and the pictures in `log` and `dataset`.
        backbone: as in `offpiste fit-pca`.
    """
    rig = load_rig("kitti")
    out.mkdir(parents=True, exist_ok=True)
    pca = out / "pca.safetensors"
    save_pca(pca, fit_pca([drive], rig, parse_split(SPLIT), open_backbone(backbone)).pca)
    dataset = make_dataset([drive], rig, out / "dataset.zarr", split=SPLIT, pca=pca)
    written = view(drive, out / "log", rig="kitti", pca=pca, rrd=False)
    written += view(dataset.path, out / "dataset")
    logger.info(carried_table(open_sensors(open_log(drive), rig)))
    logger.info(f"wrote {', '.join(map(str, written))}")


if __name__ == "__main__":
    run(main)
