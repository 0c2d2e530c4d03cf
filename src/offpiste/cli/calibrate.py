"""`offpiste calibrate`."""

from dataclasses import dataclass
from pathlib import Path
from shlex import join
from typing import Annotated

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.core.progress import show


@COMMANDS.register("calibrate")
@dataclass(frozen=True)
class Calibrate:
    """Learn how far the predictions of trained runs stray, and check that on drives that neither was fitted to."""

    runs: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RUN...")]
    """Folders of `offpiste train`; each keeps its spread (spread.safetensors) and, if it reads features, some of
    its training's ground (memory_bank.safetensors); what is kept already is used again."""
    dataset: Path
    """Dataset that the runs were trained on."""
    out: Path = Path("calibration")
    """Folder of the table, the picture and the numbers."""

    def run(self) -> int:
        """Fit, evaluate, show the table."""
        from offpiste.uncertainty.calibration import calibrate

        calibrate(self.runs, self.dataset, self.out)
        words = ["evaluate", *map(str, self.runs), "--dataset", str(self.dataset)]
        show(f"next: {join(['offpiste', *words])}")
        return 0
