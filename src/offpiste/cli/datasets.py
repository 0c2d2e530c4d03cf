"""Commands from logs to a dataset."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from offpiste.progress import show


@dataclass(frozen=True)
class FitPca:
    """Fit the PCA of patch features on images of the training stretches of logs."""

    logs: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="LOG...")]
    """Logs with cameras and LiDARs."""
    rig: str
    """A preset's name or a rig file."""
    out: Path = Path("pca.safetensors")
    """The file to write."""
    split: str = "blocks:0.7,0.1,0.2"
    """As `extract` will be told: nothing outside of the training part is looked at."""
    backbone: str = "facebook/dinov2-small"
    """A ViT by name or folder, or `filterbank`: colours and edges, without weights or download."""
    images: int | Path = 175
    """How many are looked at, chosen for diversity of ground and light; or a file that lists them, such as the
    .images.txt that is written beside the PCA."""
    components: int = 40
    """How many are kept."""
    seed: int = 0
    device: str = "cpu"

    def run(self) -> int:
        """Choose, look, fit, write."""
        from offpiste.dataset.fit_pca import fit_pca, read_image_list, write_image_list
        from offpiste.dataset.splits import parse_split
        from offpiste.perception.backbones.backbone import open_backbone
        from offpiste.perception.pca import save_pca
        from offpiste.rig.rig import load_rig

        images = read_image_list(self.images) if isinstance(self.images, Path) else self.images
        fitted = fit_pca(
            self.logs,
            load_rig(self.rig),
            parse_split(self.split),
            open_backbone(self.backbone, device=self.device),
            images=images,
            components=self.components,
            seed=self.seed,
        )
        pca = fitted.pca
        save_pca(self.out, pca)
        write_image_list(self.out.with_suffix(".images.txt"), fitted.images)
        show(f"{self.out}: {pca.components} components, {pca.variance.sum() / pca.total_variance:.1%} of the variance")
        return 0


@dataclass(frozen=True)
class Extract:
    """Bring logs to 50 Hz, split them once, and write a dataset."""

    logs: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="LOG...")]
    """Logs of one vehicle."""
    rig: str
    """A preset's name or a rig file."""
    out: Path
    """The dataset, e.g. dataset.zarr; drives that it holds already are kept."""
    split: str = "blocks:0.7,0.1,0.2"
    """blocks:TRAIN,VALIDATION,TEST by time, fold:K/N, places:METRES, or drives:FILE."""
    features: Literal["none", "ground-truth", "ground-kind"] = "none"
    """What is known of the ground under the wheels. `ground-truth`: a simulator's friction and resistance, for oracles;
    `ground-kind`: what the ground is of."""
    pca: Path | None = None
    """Visual features: a file that `fit-pca` wrote. The log needs cameras and LiDARs, and the rig must name them."""
    device: str = "cpu"
    """Where the backbone runs."""
    keyframe_metres: float = 0.5
    """An image is looked at when its camera has come so far since the last one [m]; 0 looks at all."""
    min_hindsight: float = 0.5
    """Windows of which a smaller share of the ground was ever seen are left out; 0 keeps all."""
    snapshot_seconds: float = 0.5
    """The map is kept for windows that validate and test, at most once in so long [s]."""
    processes: int = 0
    """Drives extracted at a time; 0: one a core, or one where the backbone runs on a GPU."""
    flat: bool = False
    """Leave out the slope of the driven path: all ground is flat (an ablation)."""

    def run(self) -> int:
        """Read, resample, write."""
        from offpiste.dataset.extract import make_dataset
        from offpiste.dataset.snapshots import SnapshotSettings
        from offpiste.mapping.replay import ReplaySettings
        from offpiste.rig.rig import load_rig

        rig = load_rig(self.rig)
        make_dataset(
            self.logs,
            rig.without_slope() if self.flat else rig,
            self.out,
            split=self.split,
            features=self.features,
            pca=self.pca,
            device=self.device,
            min_hindsight=self.min_hindsight,
            snapshots=SnapshotSettings(self.snapshot_seconds),
            replay=ReplaySettings(self.keyframe_metres),
            processes=self.processes,
        )
        return 0
