"""`offpiste fit-pca`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import after_logs
from offpiste.core.errors import LogError, PerceptionError
from offpiste.core.progress import show


@COMMANDS.register("fit-pca")
@dataclass(frozen=True)
class FitPca:
    """Fit the PCA of patch features on images of the training parts of logs."""

    logs: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="LOG...")]
    """Logs with cameras and LiDARs."""
    rig: str
    """Name of a preset, or a rig file; an unknown name lists the presets."""
    out: Path = Path("pca.safetensors")
    """PCA file to write."""
    split: str = "blocks:0.7,0.1,0.2"
    """Split, as in `extract`; only images of its training part are used."""
    backbone: str = "facebook/dinov2-small"
    """Name of a backbone, e.g. `filterbank` (colours and edges, without weights), or a ViT by name or folder."""
    images: int = 175
    """Number of images, chosen for diversity of ground and light; they are listed in the .images.txt beside the PCA."""
    components: int = 40
    """Number of components."""
    seed: int = 0
    """Seed of the image selection."""
    device: str = "cpu"
    """Device of the backbone."""
    processes: int = 0
    """Number of logs read in parallel; 0: one per core, or one if the backbone runs on a GPU."""
    cluster: str = ""
    """Read them on a Ray cluster instead (extra `ray`): auto, or HOST:PORT of its head. All nodes must see the logs."""

    def run(self) -> int:
        """Fit and write the PCA."""
        from offpiste.core.parallel import at_a_time
        from offpiste.dataset.fit_pca import fit_pca, write_image_list
        from offpiste.dataset.splits import parse_split
        from offpiste.perception.backbones import open_backbone
        from offpiste.perception.pca import save_pca
        from offpiste.rig.rig import load_rig

        if not self.logs:
            raise LogError("the log is missing", how="name one or more logs")
        if self.out.is_dir():
            raise PerceptionError("is a folder", where=self.out, how="give a file as --out")
        for name, least in (("images", 1), ("components", 1), ("seed", 0)):
            if (value := getattr(self, name)) < least:
                raise PerceptionError(f"invalid --{name} {value}", how=f"give {least} or more")
        fitted = fit_pca(
            self.logs,
            load_rig(self.rig),
            parse_split(self.split),
            open_backbone(self.backbone, device=self.device),
            images=self.images,
            components=self.components,
            seed=self.seed,
            processes=at_a_time(self.processes, self.device),
            cluster=self.cluster,
        )
        pca = fitted.pca
        save_pca(self.out, pca)
        write_image_list(self.out.with_suffix(".images.txt"), fitted.images)
        show(f"{self.out}: {pca.components} components, {pca.variance.sum() / pca.total_variance:.1%} of the variance")
        show(after_logs(self.logs, self.rig, "--pca", self.out, "--split", self.split))
        return 0
