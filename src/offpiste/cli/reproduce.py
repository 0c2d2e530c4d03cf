"""`offpiste reproduce`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import next_line
from offpiste.core.command_line import options


@COMMANDS.register("reproduce")
@dataclass(frozen=True)
class Reproduce:
    """Reproduce the paper's figures, from simulated drives to the report; can be resumed (needs the extra `sim`)."""

    figure: tyro.conf.Positional[Literal["fig3", "fig4"]]
    """fig3: error with hindsight features; fig4: error by viewing distance of the features."""
    size: Literal["smoke", "laptop", "evening", "day", "full", "paper"] = "smoke"
    """smoke: ten minutes; laptop: half an hour; evening; day; full: all sensors; paper: as in the paper."""
    seconds: tuple[float, float, float] | None = None
    """Duration of training, validation and test drives [s], instead of that of the size."""
    seeds: int | None = None
    """Number of runs per model, instead of that of the size."""
    out: Path = Path("results")
    """Folder of all results, shared by both figures."""
    dataset: Path | None = None
    """Dataset with visual features that replaces simulated drives."""
    backbone: str = "filterbank"
    """Backbone, as in `fit-pca`."""
    split: Literal["drives", "blocks"] = "drives"
    """Test on separate drives and worlds, or on parts of the same logs, as in the paper."""
    grip_contrast: float = 1.0
    """Contrast of grip in the simulated worlds; 0: all ground has the same grip."""
    device: str = "cpu"
    """Device of the backbone and the models."""
    processes: int = 0
    """Number of drives or runs processed in parallel; 0: one per core."""
    cluster: str = ""
    """Simulate and extract on a Ray cluster instead (extra `ray`): auto, or HOST:PORT of its head."""

    def run(self) -> int:
        """Run all steps of a figure."""
        from offpiste.core.progress import show
        from offpiste.reproduction.reproduce import reproduce
        from offpiste.reproduction.settings import ReproductionSettings, sized

        config = ReproductionSettings(
            self.figure,
            sized(self.size, self.seconds, self.seeds),
            self.out,
            dataset=self.dataset,
            backbone=self.backbone,
            split=self.split,
            contrast=self.grip_contrast,
            device=self.device,
            processes=self.processes,
            cluster=self.cluster,
        )
        reproduce(config)
        other = "fig4" if self.figure == "fig3" else "fig3"
        if not (self.out / other / "report.html").exists():
            show(next_line("reproduce", other, *options(self, "figure")))
        return 0
