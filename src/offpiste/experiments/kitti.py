"""A KITTI drive the whole way: PCA, dataset, pictures, valid rates by distance, and scans carried by the poses.

`python -m offpiste.experiments.kitti ../shared/data/kitti_raw/2011_09_26/2011_09_26_drive_0013_sync --out kitti`

Its drives are too short to be split: all of it counts as training (`blocks:1,0,0`).
"""

from pathlib import Path

import numpy as np
import tyro

from offpiste.dataset.fit_pca import fit_pca
from offpiste.dataset.make import make_dataset
from offpiste.dataset.splits import parse_split
from offpiste.experiments.carried_scans import WAYS, carried_scans
from offpiste.logs.measurements import Cloud
from offpiste.logs.open import open_log
from offpiste.logs.sensors import SensorLog, open_sensors
from offpiste.perception.backbone import open_backbone
from offpiste.perception.pca_file import save_pca
from offpiste.progress import tell
from offpiste.rig import load_rig
from offpiste.viewing.view import view

SPLIT = "blocks:1,0,0"
APART = (1, 2, 5)
"""Scans between which one is carried."""


def carried_table(log: SensorLog) -> str:
    """Distances by how far scans lie apart and by how they are carried, in lines; all LiDARs one after the other."""
    lines = [f"{'off upright planes [m]':22}" + "".join(f"{way:>20}" for way in WAYS) + "     pairs"]
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
    save_pca(pca, fit_pca([drive], rig, parse_split(SPLIT), open_backbone(backbone), tell=tell).pca)
    dataset = make_dataset([drive], rig, out / "dataset.zarr", split=SPLIT, pca=pca, tell=tell)
    written = view(drive, out / "log", rig="kitti", pca=pca, rrd=False, tell=tell)
    written += view(dataset.path, out / "dataset", tell=tell)
    tell(carried_table(open_sensors(open_log(drive), rig)))
    tell(f"wrote {', '.join(map(str, written))}")


if __name__ == "__main__":
    tyro.cli(main)
