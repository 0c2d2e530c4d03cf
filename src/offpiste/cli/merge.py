"""`offpiste merge`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import after_dataset
from offpiste.core.progress import show


@COMMANDS.register("merge")
@dataclass(frozen=True)
class Merge:
    """Bring datasets together that `extract --shard K/N` made, on one machine or several."""

    parts: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="DATASET...")]
    """Datasets of the same rig, split and settings."""
    out: Path
    """The dataset with the drives of all of them; those that it holds already are kept."""

    def run(self) -> int:
        """Check, copy, open."""
        from offpiste.dataset.merge import merge_datasets

        show(after_dataset(merge_datasets(self.parts, self.out), self.out))
        return 0
