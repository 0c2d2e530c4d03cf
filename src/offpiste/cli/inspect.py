"""`offpiste inspect`."""

import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from offpiste.cli.commands import COMMANDS
from offpiste.errors import RigError
from offpiste.progress import show


@COMMANDS.register("inspect")
@dataclass(frozen=True)
class Inspect:
    """What a careful engineer would find out first about a log; exit code 1 if it is unusable for training."""

    log: tyro.conf.Positional[str]
    """A file or folder in any format that offpiste reads."""
    rig: str | None = None
    """Name of a preset, or a rig file; without one, only what the log shows by itself is checked."""
    write_rig: Path | None = None
    """Write a first rig for this log to a new file."""
    json: bool = False
    """Print findings as JSON."""

    def run(self) -> int:
        """Inspect, print."""
        from json import dumps

        from offpiste.files import write_text
        from offpiste.inspection.draft_rig import draft_rig
        from offpiste.inspection.draft_sensors import missing
        from offpiste.inspection.inspect import inspect_log, render
        from offpiste.logs import open_log
        from offpiste.rig.rig import load_rig

        rig = load_rig(self.rig) if self.rig else None
        log = open_log(self.log, clock=rig.clock if rig else None)
        if self.write_rig and self.write_rig.exists():
            raise RigError("is there already", where=self.write_rig, how="give --write-rig a new name")
        if self.write_rig:
            drafted = draft_rig(log)
            write_text(self.write_rig, drafted)
            for line in (f"wrote {self.write_rig}", *(f"  missing: {what}" for what in missing(drafted))):
                print(line, file=sys.stderr)  # noqa: T201
        inspection = inspect_log(log, rig)
        if rig is not None and inspection.usable:
            from offpiste.inspection.sensors import check_sensors

            inspection = inspection.with_findings(check_sensors(log, rig))
        show(dumps(inspection.as_dict(), indent=2) if self.json else render(inspection))
        return 0 if inspection.usable else 1
