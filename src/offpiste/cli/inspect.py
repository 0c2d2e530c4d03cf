"""`offpiste inspect`."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import join
from typing import Annotated

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.progress import show


@COMMANDS.register("inspect")
@dataclass(frozen=True)
class Inspect:
    """What a careful engineer would find out first about a log; exit code 1 if it is unusable for training."""

    log: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="LOG")]
    """A file or folder in any format that offpiste reads, also in an object store: s3://bucket/drive.mcap."""
    rig: str | None = None
    """Name of a preset (an unknown one lists all), or a rig file; without one, only the log itself is checked."""
    write_rig: Path | None = None
    """Write a rig to a new file: the given one, or a first one for this log, with all remedies applied."""
    estimate_mountings: bool = False
    """Estimate how the rig's cameras and LiDARs are mounted, instead of the checks; the rig's mountings are guesses."""
    json: bool = False
    """Print findings as JSON."""

    def run(self) -> int:
        """Inspect, write the cured rig, print, name the next command."""
        from json import dumps

        from offpiste.inspection.draft_rig import draft_rig, refuse_existing, write_rig
        from offpiste.inspection.draft_sensors import missing
        from offpiste.inspection.inspect import inspect_log
        from offpiste.inspection.render import render
        from offpiste.logs import open_log
        from offpiste.object_store import brought
        from offpiste.rig.edits import edited_text
        from offpiste.rig.rig import load_rig, rig_text

        if self.estimate_mountings:
            return self._estimate()
        rig = load_rig(self.rig) if self.rig else None
        if self.write_rig:
            refuse_existing(self.write_rig)
        with brought(self.log) as path:
            log = open_log(path, clock=rig.clock if rig else None)
            inspection = replace(inspect_log(log, rig, sensors=True), log=self.log)
            text = rig_text(self.rig) if self.rig else draft_rig(log) if self.write_rig else ""
        show(dumps(inspection.as_dict(), indent=2) if self.json else render(inspection))
        if self.write_rig:
            write_rig(edited_text(text, inspection.cure), self.write_rig)
            lacking = [] if self.rig else missing(text)
            cured = [f"  cured: {edit}" for edit in inspection.cure]
            lines = [f"wrote {self.write_rig}", *cured, *(f"  missing: {what}" for what in lacking)]
            print(*lines, sep="\n", file=sys.stderr)  # noqa: T201
        if not self.json:
            show(f"next: {self._next(usable=inspection.usable)}")
        return 0 if inspection.usable else 1

    def _next(self, *, usable: bool) -> str:
        """The command that comes next, as a line to paste."""
        if self.write_rig:
            return join(["offpiste", "inspect", self.log, "--rig", str(self.write_rig)])
        if not self.rig:
            return join(["offpiste", "inspect", self.log, "--write-rig", "my.toml"])
        if usable:
            return join(["offpiste", "extract", self.log, "--rig", self.rig, "--out", "dataset.zarr"])
        again = join(["offpiste", "inspect", self.log, "--rig", self.rig])
        return (
            again if self.rig.endswith(".toml") else join(["offpiste", "inspect", self.log, "--write-rig", "my.toml"])
        )

    def _estimate(self) -> int:
        """Estimate mountings, print; exit code 1 if one could not be estimated."""
        from json import dumps

        from offpiste.errors import RigError
        from offpiste.inspection.estimated_mounting import render_mountings
        from offpiste.inspection.mountings import estimate_mountings
        from offpiste.logs import open_log
        from offpiste.object_store import brought
        from offpiste.rig.rig import load_rig

        if not self.rig:
            how = "give --rig; `offpiste inspect LOG --write-rig first.toml` drafts one"
            raise RigError("--estimate-mountings needs a rig that names cameras and LiDARs", how=how)
        rig = load_rig(self.rig)
        with brought(self.log) as path:
            result = estimate_mountings(open_log(path, clock=rig.clock), rig)
        as_json = {"schema": 1, "mountings": [one.as_dict() for one in result]}
        show(dumps(as_json, indent=2) if self.json else render_mountings(result))
        return 1 if any(one.refused for one in result) else 0
