"""`offpiste view`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import after_view
from offpiste.core.progress import show


@COMMANDS.register("view")
@dataclass(frozen=True)
class View:
    """Visualise a log or a dataset: pictures, a Rerun recording of a log, a report of a dataset's features."""

    path: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG|DATASET")]
    """Log with LiDARs, or dataset written by `extract`."""
    rig: str | None = None
    """Rig of a log: name of a preset, or a rig file."""
    pca: Path | None = None
    """PCA for a log: a file of `fit-pca`, or pretrained:proving-ground; without it the ground is grey."""
    out: Path = Path("view")
    """Folder of the pictures: new, empty, or of an earlier `view`."""
    run_folder: Annotated[Path | None, tyro.conf.arg(name="run", metavar="RUN")] = None
    """Run with a spread (`offpiste calibrate`) for a dataset; regions.png shows its predicted regions."""
    seconds: str = ""
    """Part of a log: A:B, A: or :B, in seconds after the first pose."""
    rrd: bool = True
    """Also write drive.rrd of a log for the Rerun viewer (needs the extra `view`)."""
    device: str = "cpu"
    """Device of the backbone."""

    def run(self) -> int:
        """Write all pictures."""
        from offpiste.visualization.view import view

        written = view(
            self.path,
            self.out,
            rig=self.rig,
            pca=self.pca,
            run=self.run_folder,
            seconds=self.seconds,
            rrd=self.rrd,
            device=self.device,
        )
        show(f"wrote {', '.join(map(str, written))}")
        show(after_view(self))
        return 0
