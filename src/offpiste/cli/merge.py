"""`offpiste merge`."""

from dataclasses import dataclass
from pathlib import Path
from shlex import join
from typing import Annotated

import tyro

from offpiste.cli.entry import COMMANDS
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
        from offpiste.merge import merge_datasets

        dataset = merge_datasets(self.parts, self.out)
        model = "dc" if dataset.features else "b"
        show(f"next: {join(['offpiste', 'train', str(self.out), '--model', model, '--out', f'runs/{model}'])}")
        return 0
