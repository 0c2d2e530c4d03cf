"""`python -m experiments.control_experiments WHAT --reproduction results/ --out controls/`; docs/controls.md."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from experiments.command import run
from experiments.control_experiments.models import models_control
from experiments.control_experiments.oracle import oracle_control
from experiments.control_experiments.reproduced import open_reproduction
from experiments.control_experiments.shift import shift_control
from experiments.control_experiments.snapshots import snapshots_control
from experiments.control_experiments.sweep import Sweep, sweep_control
from experiments.control_experiments.twins import twins_control
from experiments.control_experiments.uniform import UniformDrives, uniform_control
from offpiste.reproduction.steps import claim_folder

logger = logging.getLogger("experiments")

What = Literal["models", "snapshots", "shift", "oracle", "uniform", "twins", "contrast", "appearance"]


@dataclass(frozen=True)
class Controls:
    """Run a control; whatever is in --out already is used again."""

    what: Annotated[What, tyro.conf.Positional]
    """Which one."""
    reproduction: Path = Path("results")
    """Folder of a finished `offpiste reproduce fig4`."""
    out: Path = Path("controls")
    """Folder for everything."""
    models: tuple[str, ...] = ()
    """For `models`: only these."""
    uniform: UniformDrives = field(default_factory=UniformDrives)
    """For `uniform`: how much is driven."""

    snapshot_drives: int = 8
    """For `snapshots`: how many training drives are extracted once more."""
    snapshot_seconds: float = 0.5
    """For `snapshots`: at most one in so long [s]."""
    sweep: Sweep = field(default_factory=Sweep)
    """For `contrast` and `appearance`."""
    twin_drives: int = 4
    """For `twins`: how many test drives are driven once more."""
    twin_seconds: float = 60.0
    """For `twins`: of each [s]."""

    def run(self) -> None:
        """Do it, and show the tables."""
        of = open_reproduction(self.reproduction)
        # What was judged is used again: it must be of the same runs.
        claim_folder(self.out, {"reproduction": str(self.reproduction.resolve())})
        controls: dict[What, Callable[[], Path]] = {
            "models": lambda: models_control(of, self.out, list(self.models)),
            "snapshots": lambda: snapshots_control(
                of, self.out, drives=self.snapshot_drives, seconds=self.snapshot_seconds
            ),
            "shift": lambda: shift_control(of, self.out),
            "oracle": lambda: oracle_control(of, self.out),
            "uniform": lambda: uniform_control(of, self.out, self.uniform),
            "twins": lambda: twins_control(
                of,
                self.out,
                drives=self.twin_drives,
                seconds=self.twin_seconds,
                oracle=self.out / "oracle",
            ),
            "contrast": lambda: sweep_control(of, self.out, "contrast", self.sweep),
            "appearance": lambda: sweep_control(of, self.out, "appearance", self.sweep),
        }
        page = controls[self.what]()
        logger.info(page.read_text("utf-8"))
        logger.info(f"written: {page}")


if __name__ == "__main__":
    run(Controls)
