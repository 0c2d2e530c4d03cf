"""Many logs inspected side by side, and what was found in each, a row a log."""

import io
from collections.abc import Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.table import Table

from offpiste.core.errors import OffpisteError
from offpiste.core.object_store import brought
from offpiste.core.parallel import Report, at_a_time, run_all
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.drive import drive_name
from offpiste.logs.log import open_log
from offpiste.rig.rig import Rig


@dataclass(frozen=True)
class Job:
    """What a process needs to inspect a log."""

    log: str
    rig: Rig | None


@dataclass(frozen=True)
class Survey:
    """What `inspect` finds in several logs.

    Attributes:
        inspections: of the logs that can be read, in their order, as `Inspection.as_dict` has them.
        failed: errors of those that cannot.
    """

    inspections: tuple[dict[str, Any], ...]
    failed: tuple[OffpisteError, ...]

    @property
    def usable(self) -> bool:
        """Whether all logs can be trained on."""
        return not self.failed and all(one["usable"] for one in self.inspections)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, texts and lists, for JSON."""
        failed = [{"log": error.where, "error": str(error)} for error in self.failed]
        return {"schema": 2, "usable": self.usable, "logs": list(self.inspections), "failed": failed}


def inspect_logs(logs: Sequence[str], rig: Rig | None, *, processes: int = 1, cluster: str = "") -> Survey:
    """Inspect several logs (`inspect_log`, with their sensors).

    Args:
        processes: logs that are inspected at a time; 0: one a core.
        cluster: address of a Ray cluster that inspects them instead (`parallel.run_all`); "" for none.
    """
    jobs = [Job(log, rig) for log in logs]
    found, failed = run_all(_inspect, jobs, at_a_time(processes), "inspect", cluster=cluster, finished=lambda _: None)
    return Survey(tuple(found), tuple(failed))


def survey_table(survey: Survey) -> Table:
    """A row a log: whether it is usable, its length, and its findings, the worst in words."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("log", "for training", "findings"):
        table.add_column(name, overflow="fold")
    for name in ("s", "m"):
        table.add_column(name, justify="right")
    for one in survey.inspections:
        summary = one["summary"]
        length = "" if summary["distance"] is None else f"{summary['distance']:.0f}"
        verdict = "[green]usable[/]" if one["usable"] else "[bold red]not usable[/]"
        table.add_row(drive_name(one["log"]), verdict, _words(one["findings"]), f"{summary['duration']:.0f}", length)
    for error in survey.failed:
        table.add_row(Path(error.where).name, "[bold red]not readable[/]", error.what, "", "")
    return table


def _words(findings: Sequence[dict[str, Any]]) -> str:
    serious = [f"{one['where']} {one['what']}" for one in findings if one["severity"] != "note"]
    notes = len(findings) - len(serious)
    return "; ".join([*serious, *([f"{notes} note{'s' if notes > 1 else ''}"] if notes else [])])


def _inspect(job: Job, report: Report) -> dict[str, Any]:
    with redirect_stderr(io.StringIO()), brought(job.log) as path:  # bars of its own would run into those of others
        log = open_log(path, clock=job.rig.clock if job.rig else None)
        return replace(inspect_log(log, job.rig, sensors=True), log=job.log).as_dict()
