"""`python -m experiments.controls WHAT --reproduction results/ --out controls/`; docs/controls.md."""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from experiments.controls.models import models_control
from experiments.controls.oracle import oracle_control
from experiments.controls.reproduced import open_reproduction
from experiments.controls.shift import shift_control
from experiments.controls.snapshots import snapshots_control
from experiments.controls.sweep import Sweep, sweep_control
from experiments.controls.twins import twins_control
from experiments.controls.uniform import UniformDrives, uniform_control
from offpiste.errors import OffpisteError
from offpiste.progress import tell
from offpiste.reproduction.pieces import claim_folder

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
            "models": lambda: models_control(of, self.out, list(self.models), tell=tell),
            "snapshots": lambda: snapshots_control(
                of, self.out, drives=self.snapshot_drives, seconds=self.snapshot_seconds, tell=tell
            ),
            "shift": lambda: shift_control(of, self.out, tell=tell),
            "oracle": lambda: oracle_control(of, self.out, tell=tell),
            "uniform": lambda: uniform_control(of, self.out, self.uniform, tell=tell),
            "twins": lambda: twins_control(
                of,
                self.out,
                drives=self.twin_drives,
                seconds=self.twin_seconds,
                oracle=self.out / "oracle",
                tell=tell,
            ),
            "contrast": lambda: sweep_control(of, self.out, "contrast", self.sweep, tell=tell),
            "appearance": lambda: sweep_control(of, self.out, "appearance", self.sweep, tell=tell),
        }
        page = controls[self.what]()
        tell(page.read_text("utf-8"))
        tell(f"written: {page}")


if __name__ == "__main__":
    try:
        tyro.cli(Controls).run()
    except OffpisteError as error:
        sys.exit(str(error))
