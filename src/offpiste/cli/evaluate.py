"""`offpiste evaluate`."""

from dataclasses import dataclass
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.progress import show

if TYPE_CHECKING:
    FeatureSet = str
else:
    FeatureSet = Literal[(*FEATURE_SETS, "all")]


@COMMANDS.register("evaluate")
@dataclass(frozen=True)
class Evaluate:
    """Evaluate runs on the test part of a dataset; writes metrics.json, pictures and report.html.

    Of runs that `offpiste calibrate` has given a spread, how many errors lie in its regions (calibration.md).
    """

    runs: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RUN...")]
    """Run folders, or `pretrained:NAME`; a folder of folds counts as its folds. The report is about the first. Runs of
    one model are its seeds; where these repeat, the folders' names tell them apart: b and "b (b-longer)"."""
    dataset: Path
    """The dataset that they were trained on, or another one."""
    out: Path = Path("report")
    """Folder of the report."""
    lookup: Literal["recorded", "map", "both"] = "both"
    """Where models look the terrain up: at recorded wheels, or at predicted ones on the map, as a planner does."""
    feature_set: FeatureSet = "hindsight"
    """Feature sets read at recorded places: by the distance they were seen from [m], or the last there were."""
    min_speed: float | None = None
    """Windows start above it [m/s], 0: from standstills as well; by default as the dataset says, usually 1.5."""
    device: str = "cpu"
    """Device of the models."""

    def run(self) -> int:
        """Load, evaluate, report."""
        from offpiste.evaluation.evaluate_runs import evaluate_runs
        from offpiste.uncertainty.calibration import evaluate_kept_spreads

        # First: it may refuse a run's spread, and the evaluation takes long.
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
        else:
            words = ["calibrate", *map(str, self.runs), "--dataset", str(self.dataset)]
            show(f"next: {join(['offpiste', *words])}")
        return 0
