"""Control experiments on a finished `offpiste reproduce fig4` (docs/control-experiments.md)."""

import logging
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from experiments.command import run
from experiments.control_experiments.curve import Curve, curve_control
from experiments.control_experiments.gap import gap_control
from experiments.control_experiments.ideas import ideas_control
from experiments.control_experiments.models import models_control
from experiments.control_experiments.oracle import oracle_control
from experiments.control_experiments.reproduced import open_reproduction
from experiments.control_experiments.selection import selection_control
from experiments.control_experiments.shift import shift_control
from experiments.control_experiments.snapshots import snapshots_control
from experiments.control_experiments.standstill import standstill_control
from experiments.control_experiments.strata import strata_control
from experiments.control_experiments.sweep import Sweep, sweep_control
from experiments.control_experiments.twins import twins_control
from experiments.control_experiments.uniform import UniformDrives, uniform_control
from offpiste.reproduction.steps import claim_folder

logger = logging.getLogger("experiments")

What = Literal[
    "models",
    "snapshots",
    "selection",
    "shift",
    "oracle",
    "uniform",
    "twins",
    "contrast",
    "appearance",
    "curve",
    "ideas",
    "gap",
    "strata",
    "standstill",
]


@dataclass(frozen=True)
class ControlExperiment:
    """Run a control experiment on a finished `offpiste reproduce fig4`; results already in --out are reused."""

    what: Annotated[What, tyro.conf.Positional]
    """Name of the experiment (docs/control-experiments.md)."""
    reproduction: Path = Path("results")
    """Folder of a finished `offpiste reproduce fig4`."""
    out: Path = Path("controls")
    """Folder of all outputs."""
    models: tuple[str, ...] = ()
    """For `models` and `ideas`: names of those to train; default all."""
    seeds: int = 3
    """Number of runs of each model that is trained."""
    uniform: UniformDrives = field(default_factory=UniformDrives)
    """For `uniform`: amount of driving."""

    snapshot_drives: int = 8
    """For `snapshots`: number of training drives that are extracted once more."""
    snapshot_seconds: float = 0.5
    """For `snapshots`: least time between two [s]."""
    sweep: Sweep = field(default_factory=Sweep)
    """For `contrast` and `appearance`: values and drives."""
    curve: Curve = field(default_factory=Curve)
    """For `curve`: hours of driving and models."""
    twin_drives: int = 4
    """For `twins`: number of test drives that are simulated once more."""
    twin_seconds: float = 60.0
    """For `twins`: duration of each [s]."""

    def run(self) -> None:
        """Run the experiment, and show its tables."""
        of = open_reproduction(self.reproduction)
        # Evaluations in the folder are reused: they must belong to the same runs.
        size = {"size": {key: value for key, value in asdict(of.size).items() if key != "seeds"}}  # they may grow
        claim_folder(self.out, {"reproduction": str(self.reproduction.resolve()), **size}, defaults=size)
        experiments: dict[What, Callable[[], Path]] = {
            "models": lambda: models_control(of, self.out, list(self.models), self.seeds),
            "snapshots": lambda: snapshots_control(
                of, self.out, drives=self.snapshot_drives, seconds=self.snapshot_seconds, seeds=self.seeds
            ),
            "selection": lambda: selection_control(of, self.out),
            "shift": lambda: shift_control(of, self.out),
            "oracle": lambda: oracle_control(of, self.out, self.seeds),
            "uniform": lambda: uniform_control(of, self.out, self.uniform, self.seeds),
            "twins": lambda: twins_control(
                of,
                self.out,
                drives=self.twin_drives,
                seconds=self.twin_seconds,
                oracle=self.out / "oracle",
            ),
            "contrast": lambda: sweep_control(of, self.out, "contrast", self.sweep, self.seeds),
            "curve": lambda: curve_control(of, self.out, self.curve, self.seeds),
            "strata": lambda: strata_control(of, self.out),
            "standstill": lambda: standstill_control(of, self.out),
            "gap": lambda: gap_control(of, self.out, self.seeds),
            "ideas": lambda: ideas_control(of, self.out, list(self.models), self.seeds),
            "appearance": lambda: sweep_control(of, self.out, "appearance", self.sweep, self.seeds),
        }
        page = experiments[self.what]()
        logger.info(page.read_text("utf-8"))
        logger.info(f"written: {page}")


if __name__ == "__main__":
    run(ControlExperiment)
