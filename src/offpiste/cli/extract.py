"""`offpiste extract`."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import after_extraction
from offpiste.core.conventions import PERCEPTION_LATENCY
from offpiste.core.errors import PerceptionError
from offpiste.core.progress import show


@COMMANDS.register("extract")
@dataclass(frozen=True)
class Extract:
    """Resample logs to 50 Hz, assign the split, and write a dataset."""

    logs: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="LOG...")]
    """Logs of one vehicle; URLs of an object store, too, and patterns of them."""
    rig: str
    """Name of a preset, or a rig file; an unknown name lists those there are."""
    out: Path
    """The dataset, e.g. dataset.zarr or s3://bucket/dataset.zarr; drives already in it are kept."""
    split: str = "blocks:0.7,0.1,0.2"
    """blocks:TRAIN,VALIDATION,TEST by time (@SECONDS: repeated), fold:K/N (K from 0), places:METRES, or drives:FILE."""
    features: Literal["none", "ground-truth", "ground-kind"] = "none"
    """What is known of the ground under the wheels. `ground-truth`: a simulator's friction and resistance, for oracles;
    `ground-kind`: the kind of ground."""
    pca: Path | None = None
    """Visual features: a file of `fit-pca`, or pretrained:proving-ground; the rig must name cameras and LiDARs."""
    device: str = "cpu"
    """Device of the backbone."""
    keyframe_metres: float = 0.5
    """Distance that a camera moves from one keyframe to the next [m]; 0: every image is a keyframe."""
    min_hindsight: float = 0.5
    """Windows are left out if a smaller share of their ground was ever seen; 0 keeps all."""
    snapshot_seconds: float = 0.5
    """Shortest time between snapshots of the map, which are kept for windows that validate and test [s]."""
    snapshot_speed: float | None = None
    """Windows that start above it have snapshots [m/s], 0: standstills as well; by default those above 1.5 m/s."""
    latency: float = PERCEPTION_LATENCY
    """Snapshots hold what was measured this long before their windows start, or earlier [s]; `drive` has the same."""
    shard: str = ""
    """K/N: only every Nth of these logs, beginning with the Kth; `offpiste merge` brings the N datasets together."""
    processes: int = 0
    """Drives extracted at a time; 0: one a core, or one where the backbone runs on a GPU."""
    cluster: str = ""
    """Extract on a Ray cluster instead (extra `ray`): auto, or HOST:PORT of its head. All nodes must see the files."""
    force: bool = False
    """Also extract logs in which `inspect` finds something fatal."""
    flat: bool = False
    """Leave out the slope of the driven path: all ground is flat (an ablation)."""

    def run(self) -> int:
        """Read, resample, write."""
        from offpiste.core.parallel import parse_shard
        from offpiste.dataset.assumptions import assumptions_block, assumptions_of
        from offpiste.dataset.extract import make_dataset
        from offpiste.dataset.map_snapshots import SnapshotSettings
        from offpiste.mapping.replay import MapperSettings
        from offpiste.rig.rig import load_rig

        if not 0 <= self.keyframe_metres < math.inf:
            raise PerceptionError(f"--keyframe-metres is {self.keyframe_metres:g}", how="give a distance of 0 or more")
        rig = load_rig(self.rig)
        dataset = make_dataset(
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
