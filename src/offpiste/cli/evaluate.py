"""`offpiste evaluate` and `offpiste calibrate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import after_evaluation, next_line
from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.progress import show

if TYPE_CHECKING:
    FeatureSet = str
else:
    FeatureSet = Literal[(*FEATURE_SETS, "all")]


@COMMANDS.register("evaluate")
@dataclass(frozen=True)
class Evaluate:
    """Evaluate runs on the test part of a dataset; writes metrics.json, figures and report.html.

    For runs with a spread (`offpiste calibrate`), the calibration on these windows as well (calibration.md).
    """

    runs: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RUN...")]
    """Run folders, folders of folds, or `pretrained:NAME`. The report is about the first. Runs of one model are its
    seeds; runs of the same seed are named by their folders: b and "b (b-longer)"."""
    dataset: Path
    """Dataset of the evaluation: the training dataset or another one."""
    out: Path = Path("report")
    """Folder of the report."""
    lookup: Literal["recorded", "map", "both"] = "both"
    """Source of the terrain: under recorded wheels, or on the map under predicted wheels, as in planning."""
    feature_set: FeatureSet = "hindsight"
    """Feature sets at recorded positions, by viewing distance [m]."""
    min_speed: float | None = None
    """Smallest speed at the start of a window [m/s], 0 to include standstills; by default that of the dataset."""
    device: str = "cpu"
    """Device of the models."""

    def run(self) -> int:
        """Evaluate and write the report."""
        from offpiste.evaluation.evaluate_runs import evaluate_runs
        from offpiste.uncertainty.calibration import evaluate_kept_spreads

        # First, because it may refuse the spread of a run and the evaluation takes long.
        spreads = evaluate_kept_spreads(self.runs, self.dataset, self.min_speed)
        lookups: tuple[Literal["recorded", "map"], ...] = ("recorded", "map")
        evaluate_runs(
            self.runs,
            self.dataset,
            self.out,
            lookups=lookups if self.lookup == "both" else (self.lookup,),
            feature_sets=FEATURE_SETS if self.feature_set == "all" else (self.feature_set,),
            min_speed=self.min_speed,
            device=self.device,
        )
        if spreads is not None:
            spreads.write(self.out)
        show(after_evaluation(self.runs, self.dataset))
        return 0


@COMMANDS.register("calibrate")
@dataclass(frozen=True)
class Calibrate:
    """Fit the spread of the predictions of runs, and test its calibration on held-out drives."""

    runs: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RUN...")]
    """Run folders. Each receives a spread (spread.safetensors) and, if it reads features, a memory bank of known ground
    (memory_bank.safetensors); existing ones are reused."""
    dataset: Path
    """Training dataset of the runs."""
    out: Path = Path("calibration")
    """Folder of the table, the figure and the numbers."""

    def run(self) -> int:
        """Fit and evaluate the spread."""
        from offpiste.uncertainty.calibration import calibrate

        calibrate(self.runs, self.dataset, self.out)
        show(next_line("evaluate", *self.runs, "--dataset", self.dataset))
        return 0
