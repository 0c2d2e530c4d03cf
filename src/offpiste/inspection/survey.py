"""Inspection of several logs and a summary table."""

import io
from collections.abc import Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass, replace
from functools import partial
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
class Survey:
    """Inspections of several logs.

    Attributes:
        inspections: results for readable logs in their order, as returned by `Inspection.as_dict`.
        failed: errors of unreadable logs.
    """

    inspections: tuple[dict[str, Any], ...]
    failed: tuple[OffpisteError, ...]

    @property
    def usable(self) -> bool:
        """Return whether all logs are usable for training."""
        return not self.failed and all(one["usable"] for one in self.inspections)

    def as_dict(self) -> dict[str, Any]:
        """Return the survey as plain numbers, strings and lists for JSON."""
        failed = [{"log": error.where, "error": str(error)} for error in self.failed]
        return {"schema": 2, "usable": self.usable, "logs": list(self.inspections), "failed": failed}


def inspect_logs(logs: Sequence[str], rig: Rig | None, *, processes: int = 1, cluster: str = "") -> Survey:
    """Inspect several logs including their sensors (`inspect_log`).

    Args:
        processes: number of parallel inspections; 0: one per core.
        cluster: address of a Ray cluster to use instead (`parallel.run_all`); "" for none.
    """
    work = partial(_inspect, rig=rig)
    found, failed = run_all(work, logs, at_a_time(processes), "inspect", cluster=cluster, finished=lambda _: None)
    return Survey(tuple(found), tuple(failed))


def survey_table(survey: Survey) -> Table:
    """Return a table with one row per log: usability, length and findings, with serious findings in full."""
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


def _inspect(name: str, report: Report, *, rig: Rig | None) -> dict[str, Any]:
    with redirect_stderr(io.StringIO()), brought(name) as path:  # suppress progress bars of the worker
        log = open_log(path, clock=rig.clock if rig else None)
        return replace(inspect_log(log, rig, sensors=True), log=name).as_dict()
