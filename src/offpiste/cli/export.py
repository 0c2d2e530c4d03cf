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
    """Write a trained model as files that run without Python, with an example and reference outputs."""

    model: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")]
    """Folder written by `offpiste train`, or `pretrained:NAME`."""
    to: Annotated[Path, tyro.conf.arg(aliases=("--out",))]
    """New or empty folder to write."""
    format: str = "c"
    """Format: c or cuda (one header with the weights), mppi-generic (dynamics for that library), or onnx (graphs of the
    feature encoder and of the initial state, extra `onnx`)."""
    images: Path | None = None
    """Folder of rectified images to calibrate int8 graphs of onnx; without it no int8 graph is written."""
    size: Annotated[str | None, tyro.conf.arg(metavar="WIDTHxHEIGHT")] = None
    """Size of the rectified images of onnx [px], equal to that of feature extraction; by default 640x360."""

    def run(self) -> int:
        """Export the run."""
        from offpiste.exports.formats import ImageOptions, export, size_of

        size = None if self.size is None else size_of(self.size)
        export(self.model, self.to, self.format, ImageOptions(self.images, size))
        show(f"{self.to}: see README.md there")
        return 0
