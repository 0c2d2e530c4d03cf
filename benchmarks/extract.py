"""Extraction: seconds per second of drive, with and without the backbone, by the number of images; and the store.

`python benchmarks/extract.py LOG PCA [--rig proving_ground]`: plays a drive (20 s are enough) back again and again,
side by side in one run: the scans alone; then with the images of every frame, and of one every 0.5, 1 and 2 m,
with the share of valid cells at each distance, and how far hindsight's features lie from those of every frame (the
mean over cells of the l2 distance, over that between two cells taken at random). Then it extracts the drive and reads
windows and snapshots back.
"""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tyro

from offpiste.core.conventions import FEATURE_SETS
from offpiste.dataset.extract import make_dataset
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.resample import Rows, extract_rows
from offpiste.dataset.visual_features import with_visual_features
from offpiste.dataset.windows import Windows
from offpiste.logs.drive import drive_from_log
from offpiste.logs.opening import open_log
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.mapping.replay import MapperSettings, replay
from offpiste.perception.feature_extractor import FeatureExtractor, load_feature_extractor
from offpiste.rig.rig import Rig, load_rig


@dataclass(frozen=True)
class Counting(FeatureExtractor):
    """A feature extractor that keeps the time of each image [s]."""

    times: list[float] = field(default_factory=list)

    def extract(self, pixels: np.ndarray) -> np.ndarray:
        """Return the features of an image."""
        began = time.perf_counter()
        features = super().extract(pixels)
        self.times.append(time.perf_counter() - began)
        return features


def scans_alone(log: SensorLog, extractor: FeatureExtractor, start: float, end: float) -> float:
    """Processor time of the scans without images [s]."""
    began = time.process_time()
    for _ in replay(log, {}, extractor.extract, 0, start=start, end=end):
        pass
    return time.process_time() - began


def apart(cells: Cells, other: Cells) -> float:
    """How far hindsight's features are from those of `other`, relative to cells taken at random."""
    both = np.flatnonzero(cells.valid[0] & other.valid[0])
    one, two = cells.features[0, both].astype(np.float64), other.features[0, both].astype(np.float64)
    random = two[np.random.default_rng(0).permutation(len(two))]
    return float(np.linalg.norm(one - two, axis=1).mean() / np.linalg.norm(random - two, axis=1).mean())


def playing(log: SensorLog, rows: Rows, rig: Rig, extractor: FeatureExtractor, spacings: Sequence[float]) -> None:
    """The table of playing back."""
    start, end = rows.time[0], rows.time[-1]
    seconds = end - start
    print(f"{seconds:.0f} s of {Path(log.path).name}, {rows.distance:.0f} m; processor seconds per second of drive")
    print(f"scans alone               {scans_alone(log, extractor, start, end) / seconds:5.2f}")
    every: Cells | None = None
    for metres in spacings:
        counting = Counting(extractor.backbone, extractor.pca)
        began = time.process_time()
        cells = with_visual_features(rows, log, rig, counting, MapperSettings(metres)).cells
        spent = (time.process_time() - began) / seconds
        assert cells is not None
        every = every or cells
        rates = " ".join(
            f"{name} {rate:.2f}" for name, rate in zip(FEATURE_SETS, cells.valid.mean(axis=1), strict=True)
        )
        what = f"every {metres:g} m" if metres else "every frame"
        share = sum(counting.times) / seconds
        about = f"{len(counting.times):4} images, backbone {share:4.2f} s"
        print(f"{what:12} {about} {spent:5.2f}   valid: {rates}   apart {apart(cells, every):.3f}")


def reading(log: Path, rig: Rig, pca: Path) -> None:
    """Windows and snapshots from the store."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "parts.txt").write_text(f"{log.stem} test\n")
        began = time.perf_counter()
        dataset = make_dataset([log], rig, Path(folder) / "d.zarr", split=f"drives:{folder}/parts.txt", pca=pca)
        spent = time.perf_counter() - began
        length = len(dataset.drives[0].rows.time) * 0.02
        print(f"extract, whole drive: {spent / length:.2f} s per second of drive by the clock")
        windows = Windows(dataset, "test")
        index = np.random.default_rng(0).integers(0, len(windows), 1024)
        times = []
        for _ in range(7):
            began = time.perf_counter()
            windows.gather(index)
            times.append(time.perf_counter() - began)
        print(f"windows with features: {1024 / np.median(times):,.0f} a second")
        snapped = windows.evaluation_indices(5)[:32]
        began = time.perf_counter()
        windows.maps.of(snapped)
        size = sum(f.stat().st_size for f in (Path(folder) / "d.zarr").rglob("snapshots/**/*") if f.is_file())
        count = len(windows.evaluation_indices(5))
        print(
            f"snapshots: {len(snapped) / (time.perf_counter() - began):.0f} a second, {size / count / 1e6:.1f} MB each"
        )


def main(
    log: tyro.conf.Positional[Path], pca: tyro.conf.Positional[Path], rig: str = "proving_ground", smoke: bool = False
) -> None:
    """Print the tables.

    Args:
        smoke: one spacing of images only, to try it.
    """
    loaded = load_rig(rig)
    opened = open_log(log)
    rows = extract_rows(drive_from_log(opened, loaded))
    extractor = load_feature_extractor(pca)
    sensors = open_sensors(opened, loaded)
    extractor.extract(np.zeros((140, 140, 3), np.uint8))
    scans_alone(sensors, extractor, rows.time[0], rows.time[0] + 1)  # compiles
    playing(sensors, rows, loaded, extractor, (2.0,) if smoke else (0.0, 0.5, 1.0, 2.0))
    reading(log, loaded, pca)


if __name__ == "__main__":
    tyro.cli(main)
