"""`offpiste export`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.core.progress import show


@COMMANDS.register("export")
@dataclass(frozen=True)
class Export:
    """Write a trained model as files that run without Python, with an example and a file to check it with."""

    model: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")]
    """Folder that `offpiste train` wrote, or `pretrained:NAME`."""
    to: Annotated[Path, tyro.conf.arg(aliases=("--out",))]
    """Folder to write; not there yet, or empty."""
    format: str = "c"
    """What to write: c or cuda, one header with the weights; mppi-generic, dynamics for that library; onnx, graphs from
    images to codes and from the last 0.2 s to the start (extra `onnx`)."""
    images: Path | None = None
    """A folder of rectified pictures, by which int8 of onnx is calibrated; without one there is no int8."""
    size: Annotated[str | None, tyro.conf.arg(metavar="WIDTHxHEIGHT")] = None
    """Width and height of the rectified images of onnx [px], those with which features were extracted; 640x360 unless
    given."""

    def run(self) -> int:
        """Read the run, write the folder."""
        from offpiste.exports.formats import ImageOptions, export, size_of

        size = None if self.size is None else size_of(self.size)
        export(self.model, self.to, self.format, ImageOptions(self.images, size))
        show(f"{self.to}: see README.md there")
        return 0
