"""`offpiste inspect`."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import after_inspection, after_survey
from offpiste.core.progress import show

if TYPE_CHECKING:
    from offpiste.rig.rig import Rig


@COMMANDS.register("inspect")
@dataclass(frozen=True)
class Inspect:
    """Check a log and its rig for faults; exit code 1 if the log is unusable for training."""

    logs: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="LOG...")]
    """Log file or folder in any supported format, also in an object store (s3://bucket/drive.mcap). Several logs give
    one row each."""
    rig: str | None = None
    """Name of a preset, or a rig file; an unknown name lists the presets. Without a rig, only the log is checked."""
    time: str = ""
    """Time column of a table, whose unit follows from its name or rate; `clock.column` in a rig."""
    namespace: str = ""
    """Namespace of the vehicle in a log of several vehicles, e.g. /robot1."""
    write_rig: Path | None = None
    """New rig file: the given rig, or a draft for this log, with all fixes applied."""
    estimate_mountings: bool = False
    """Estimate the mountings of cameras and LiDARs instead of the checks, from those of the rig as initial guess."""
    json: bool = False
    """Print findings as JSON."""
    processes: int = 0
    """Number of logs inspected in parallel; 0: one per core."""
    cluster: str = ""
    """Inspect several logs on a Ray cluster instead (extra `ray`): auto, or HOST:PORT of its head."""

    def run(self) -> int:
        """Inspect one or several logs, or estimate mountings."""
        from offpiste.core.errors import LogError, SeveralLogs
        from offpiste.core.object_store import expanded, url_of
        from offpiste.rig.rig import load_rig

        logs = [str(log) for log in expanded(self.logs)]
        if not logs:
            raise LogError("the log is missing", how="name one or more logs")
        if (self.time or self.namespace) and self.rig:
            option, how = ("--time", "set clock.column") if self.time else ("--namespace", "name the topics")
            raise LogError(f"{option} is for a log without a rig", how=f"{how} in the rig")
        if len(logs) > 1:
            return self._survey(logs)
        if self.estimate_mountings:
            return self._estimate(logs[0])
        try:
            return self._inspect(logs[0], load_rig(self.rig) if self.rig else None)
        except SeveralLogs as error:
            if error.others:
                print(f"ignored in {logs[0]}: {', '.join(error.others)}", file=sys.stderr)  # noqa: T201
            inside = [str(Path(logs[0]) / name) for name in error.logs]
            return self._survey([url_of(log) or log for log in inside])

    def _inspect(self, path: str, rig: "Rig | None") -> int:
        from json import dumps

        from offpiste.core.files import write_text
        from offpiste.core.object_store import brought
        from offpiste.inspection.draft_rig import draft_rig, refuse_existing
        from offpiste.inspection.draft_sensors import missing
        from offpiste.inspection.inspect import inspect_log
        from offpiste.inspection.render import render
        from offpiste.logs import open_log
        from offpiste.rig.channels import Clock
        from offpiste.rig.edits import edited_text
        from offpiste.rig.rig import rig_text

        if self.write_rig:
            refuse_existing(self.write_rig)
        with brought(path) as here:
            named = Clock(column=self.time, unit="") if self.time else Clock()  # type: ignore[arg-type]
            log = open_log(here, clock=rig.clock if rig else named)
            inspection = replace(inspect_log(log, rig, sensors=True, namespace=self.namespace), log=path)
            show(dumps(inspection.as_dict(), indent=2) if self.json else render(inspection))
            text = rig_text(self.rig) if self.rig else draft_rig(log, self.namespace) if self.write_rig else ""
        if self.write_rig:
            refuse_existing(self.write_rig)
            write_text(self.write_rig, edited_text(text, inspection.cure))
            lacking = [] if self.rig else missing(text)
            cured = [f"  cured: {edit}" for edit in inspection.cure]
            lines = [f"wrote {self.write_rig}", *cured, *(f"  missing: {what}" for what in lacking)]
            print(*lines, sep="\n", file=sys.stderr)  # noqa: T201
        if not self.json:
            show(after_inspection(self, path, inspection))
        return 0 if inspection.usable else 1

    def _survey(self, logs: list[str]) -> int:
        """Inspect several logs; exit code 1 if one of them is unusable."""
        from json import dumps

        from offpiste.core.errors import LogError
        from offpiste.inspection.survey import inspect_logs, survey_table
        from offpiste.rig.rig import load_rig

        given: dict[str, object] = {"--write-rig": self.write_rig, "--estimate-mountings": self.estimate_mountings}
        given |= {"--time": self.time, "--namespace": self.namespace}
        if options := [option for option, value in given.items() if value]:
            raise LogError(f"{options[0]} takes one log, not {len(logs)}", how="give one of them")
        rig = load_rig(self.rig) if self.rig else None
        survey = inspect_logs(logs, rig, processes=self.processes, cluster=self.cluster)
        show(dumps(survey.as_dict(), indent=2) if self.json else survey_table(survey))
        if not self.json:
            show(after_survey(logs, self.rig, usable=survey.usable))
        return 0 if survey.usable else 1

    def _estimate(self, log: str) -> int:
        """Estimate mountings; exit code 1 if one cannot be estimated."""
        from json import dumps

        from offpiste.calibration.mountings import estimate_mountings, render_mountings
        from offpiste.core.errors import RigError
        from offpiste.core.object_store import brought
        from offpiste.logs import open_log
        from offpiste.rig.rig import load_rig

        if not self.rig:
            how = "give --rig; `offpiste inspect LOG --write-rig first.toml` drafts one"
            raise RigError("--estimate-mountings needs a rig that names cameras and LiDARs", how=how)
        rig = load_rig(self.rig)
        with brought(log) as here:
            result = estimate_mountings(open_log(here, clock=rig.clock), rig)
        as_json = {"schema": 1, "mountings": [one.as_dict() for one in result]}
        show(dumps(as_json, indent=2) if self.json else render_mountings(result))
        return 1 if any(one.refused for one in result) else 0
