"""`offpiste reproduce`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from offpiste.cli.entry import COMMANDS


@COMMANDS.register("reproduce")
@dataclass(frozen=True)
class Reproduce:
    """Reproduce the paper's figures, from drives to pictures; resumes where it stopped (needs the extra `sim`)."""

    figure: tyro.conf.Positional[Literal["fig3", "fig4"]]
    """fig3: error with features in hindsight; fig4: error by the distance that features were seen from."""
    size: Literal["smoke", "laptop", "evening", "day", "full", "paper"] = "smoke"
    """Ten minutes, half an hour, an evening, a day, a smaller set with all sensors, or as much as in the paper."""
    seconds: tuple[float, float, float] | None = None
    """Driving to train, validate and test on [s], instead of the size's."""
    seeds: int | None = None
    """Runs of each model of the figure, instead of the size's."""
    out: Path = Path("results")
    """Folder for everything; both figures share it."""
    dataset: Path | None = None
    """A dataset with visual features, used instead of simulating."""
    backbone: str = "filterbank"
    """Backbone, as in `fit-pca`."""
    split: Literal["drives", "blocks"] = "drives"
    """Test on drives in worlds of their own, or on stretches of the same logs, as the paper does."""
    grip_contrast: float = 1.0
    """Contrast of grip in the simulated worlds; 0: all ground drives alike."""
    device: str = "cpu"
    """Device of the backbone and the models."""
    processes: int = 0
    """Drives simulated or extracted, and runs trained or evaluated, at a time; 0: one a core."""
    cluster: str = ""
    """Simulate and extract on a Ray cluster instead (extra `ray`): auto, or HOST:PORT of its head."""

    def run(self) -> int:
        """Drive, extract, train, evaluate, draw."""
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
        return 0
