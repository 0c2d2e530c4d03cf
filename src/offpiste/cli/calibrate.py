"""`offpiste calibrate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import next_line
from offpiste.core.progress import show


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
