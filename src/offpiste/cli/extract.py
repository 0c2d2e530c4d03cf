"""`offpiste extract` and `offpiste merge`."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import after_dataset, after_extraction
from offpiste.core.conventions import PERCEPTION_LATENCY
from offpiste.core.errors import PerceptionError
from offpiste.core.progress import show


@COMMANDS.register("extract")
@dataclass(frozen=True)
class Extract:
    """Resample logs to 50 Hz, assign the split, and write a dataset."""

    logs: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="LOG...")]
    """Logs of one vehicle, also URLs of an object store and patterns of these."""
    rig: str
    """Name of a preset, or a rig file; an unknown name lists the presets."""
    out: Path
    """Dataset to write, e.g. dataset.zarr; existing drives are kept."""
    split: str = "blocks:0.7,0.1,0.2"
    """blocks:TRAIN,VALIDATION,TEST by time (@SECONDS: repeated), fold:K/N (K from 0), places:METRES, or drives:FILE."""
    features: Literal["none", "ground-truth", "ground-kind"] = "none"
    """Simulated features of the ground under the wheels: true friction and resistance, or the kind of ground."""
    pca: Path | None = None
    """PCA of visual features: a file of `fit-pca`, or pretrained:proving-ground; the rig needs cameras and LiDARs."""
    device: str = "cpu"
    """Device of the backbone."""
    keyframe_metres: float = 0.5
    """Distance between keyframes of a camera [m]; 0 uses every image."""
    min_hindsight: float = 0.5
    """Smallest share of observed ground in a window; others are dropped."""
    snapshot_seconds: float = 0.5
    """Shortest time between map snapshots, which validation and test windows use [s]."""
    snapshot_speed: float | None = None
    """Smallest initial speed of windows with snapshots [m/s], 0 to include standstills; by default 1.5 m/s."""
    latency: float = PERCEPTION_LATENCY
    """Time from the last measurement in a snapshot to the start of its window [s], as in `drive`."""
    shard: str = ""
    """K/N: only every Nth log, beginning with the Kth; `offpiste merge` merges the N datasets."""
    processes: int = 0
    """Number of drives extracted in parallel; 0: one per core, or one if the backbone runs on a GPU."""
    cluster: str = ""
    """Extract on a Ray cluster instead (extra `ray`): auto, or HOST:PORT of its head. All nodes must see the files."""
    force: bool = False
    """Also extract logs with fatal findings of `inspect`."""
    flat: bool = False
    """Ignore the slope of the driven path, as if all ground were flat (an ablation)."""

    def run(self) -> int:
        """Extract the logs."""
        from offpiste.core.parallel import parse_shard
        from offpiste.dataset.assumptions import assumptions_block, assumptions_of
        from offpiste.dataset.map_snapshots import SnapshotSettings
        from offpiste.inspection.extract import extract
        from offpiste.mapping.replay import MapperSettings
        from offpiste.rig.rig import load_rig

        if not 0 <= self.keyframe_metres < math.inf:
            raise PerceptionError(
                f"invalid --keyframe-metres {self.keyframe_metres:g}", how="give a distance of 0 or more"
            )
        rig = load_rig(self.rig)
        dataset = extract(
            self.logs,
            rig.without_slope() if self.flat else rig,
            self.out,
            split=self.split,
            features=self.features,
            pca=self.pca,
            device=self.device,
            min_hindsight=self.min_hindsight,
            snapshots=SnapshotSettings(self.snapshot_seconds, latency=self.latency, min_speed=self.snapshot_speed),
            replay=MapperSettings(self.keyframe_metres),
            shard=parse_shard(self.shard) if self.shard else (1, 1),
            processes=self.processes,
            cluster=self.cluster,
            force=self.force,
        )
        show(assumptions_block(assumptions_of(dataset)))
        show(after_extraction(self, dataset))
        return 0


@COMMANDS.register("merge")
@dataclass(frozen=True)
class Merge:
    """Merge the datasets of `extract --shard K/N`, from one or several machines."""

    parts: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="DATASET...")]
    """Datasets with the same rig, split and settings."""
    out: Path
    """Merged dataset; existing drives are kept."""

    def run(self) -> int:
        """Merge the datasets."""
        from offpiste.dataset.merge import merge_datasets

        show(after_dataset(merge_datasets(self.parts, self.out), self.out))
        return 0
