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
    """Look at a log or a dataset: pictures, a Rerun recording of a log, and the report of a dataset's features."""

    path: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG|DATASET")]
    """The file or folder of a drive with LiDARs, or a dataset that `extract` wrote."""
    rig: str | None = None
    """For a log: name of a preset, or a rig file."""
    pca: Path | None = None
    """For a log: a file of `fit-pca`, or pretrained:proving-ground; without one, ground is grey."""
    out: Path = Path("view")
    """Folder of the pictures: empty, not there yet, or of an earlier `view`."""
    run_folder: Annotated[Path | None, tyro.conf.arg(name="run", metavar="RUN")] = None
    """For a dataset: a run with a spread (`offpiste calibrate`); regions.png shows where it predicts the vehicle."""
    seconds: str = ""
    """For a log: a stretch A:B, A: or :B, in seconds after the first pose."""
    rrd: bool = True
    """For a log: also write drive.rrd for the Rerun viewer (needs the extra `view`)."""
    device: str = "cpu"
    """Device of the backbone."""

    def run(self) -> int:
        """Play back or open, draw, write."""
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
