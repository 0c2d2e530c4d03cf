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
    """Merge the datasets of `extract --shard K/N`, from one or several machines."""

    parts: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="DATASET...")]
    """Datasets with the same rig, split and settings."""
    out: Path
    """Merged dataset; existing drives are kept."""

    def run(self) -> int:
        """Merge the datasets."""
        from offpiste.dataset.merge import merge_datasets

        show(after_dataset(merge_datasets(self.parts, self.out), self.out))
        return 0
