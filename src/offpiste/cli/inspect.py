"""`offpiste inspect`."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.progress import show


@COMMANDS.register("inspect")
@dataclass(frozen=True)
class Inspect:
    """What a careful engineer would find out first about a log; exit code 1 if it is unusable for training."""

    log: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="LOG")]
    """A file or folder in any format that offpiste reads."""
    rig: str | None = None
    """Name of a preset (an unknown one lists all), or a rig file; without one, only the log itself is checked."""
    write_rig: Path | None = None
    """Write a first rig for this log to a new file."""
    json: bool = False
    """Print findings as JSON."""

    def run(self) -> int:
        """Draft a rig, inspect, print."""
        from json import dumps

        from offpiste.inspection.draft_rig import write_draft
        from offpiste.inspection.inspect import inspect_log, render
        from offpiste.logs import open_log
        from offpiste.rig.rig import load_rig

        rig = load_rig(self.rig) if self.rig else None
        log = open_log(self.log, clock=rig.clock if rig else None)
        if self.write_rig:
            lacking = write_draft(log, self.write_rig)
            print(f"wrote {self.write_rig}", *(f"  missing: {what}" for what in lacking), sep="\n", file=sys.stderr)  # noqa: T201
        inspection = inspect_log(log, rig, sensors=True)
        show(dumps(inspection.as_dict(), indent=2) if self.json else render(inspection))
        return 0 if inspection.usable else 1
