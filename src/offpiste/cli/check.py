"""`offpiste check`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.core.errors import OffpisteError


@COMMANDS.register("check")
@dataclass(frozen=True)
class Check:
    """Compare all files of runs, datasets and PCAs with their checksums; exit 1 if a file is damaged."""

    paths: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="PATH...")]
    """Runs (or `pretrained:NAME`), datasets, PCA files, or folders of these."""

    def run(self) -> int:
        """Check all paths."""
        from offpiste.training.file_check import check_paths

        if not self.paths:
            raise OffpisteError("nothing to check", how="name runs, datasets or PCA files")
        return 1 if check_paths(self.paths) else 0
