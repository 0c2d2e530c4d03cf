"""Score `offpiste inspect` on logs with known faults: `python -m experiments.inspection_faults --out faults`."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from experiments.command import run
from experiments.inspection_faults import results
from experiments.inspection_faults.faults import FAULTS, fault_named
from experiments.inspection_faults.report import report, shown
from experiments.inspection_faults.score import FaultCase, Score, fault_case, score
from offpiste.core.files import check_folder
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.render import render


@dataclass(frozen=True)
class InspectionFaults:
    """Score inspect on simulated logs: a random vehicle, drive and logger each, healthy or with one to three faults."""

    out: Path = Path("inspection-faults")
    """Folder of results: a JSON line per log, and report.md; finished logs are not repeated."""
    logs: int = 200
    """Number of logs."""
    seed: int = 1
    """Seed of the first log; the others follow."""
    fault: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = ()
    """Faults to choose from, one per log; all, and some healthy logs, if none is given."""
    healthy: bool = False
    """Healthy logs only."""
    processes: int = 1
    """Logs at a time."""
    cache: Path | None = None
    """Folder of simulated drives; OUT/drives if not given."""
    only: int | None = None
    """Score the log of this seed alone, and print its truth and its inspection."""
    list: bool = False
    """Print the names of the faults."""

    def run(self) -> str:
        """Score the logs that are missing, and report."""
        if self.list:
            return "\n".join(f"{one.name}: {', '.join(map(str, one.strengths))} {one.unit}" for one in FAULTS.values())
        check_folder(self.out)
        for name in self.fault:
            fault_named(name)
        if self.only is not None:
            one = self.case(self.only)
            truth = ", ".join(map(str, (*one.given, *one.changes))) or "healthy"
            inspection = render(inspect_log(one.case.log, one.case.rig))
            return f"truth: {truth}\n{inspection}\n{_summary(score(one))}"
        seeds = range(self.seed, self.seed + self.logs)
        return results.reported(self.out, Score, seeds, partial(_work, self), report, processes=self.processes)

    def case(self, seed: int) -> FaultCase:
        """The case of a seed."""
        return fault_case(seed, self.cache or self.out / "drives", self.fault, healthy=self.healthy)


def _work(settings: InspectionFaults, seed: int, progress: Callable[[float], None]) -> str:
    result = score(settings.case(seed))
    results.append(settings.out, result)
    return _summary(result)


def _summary(one: Score) -> str:
    faults = [f"{f.name} ({f.strength:g}) {'found' if f.found else 'missed'} {f.first_fix}".strip() for f in one.faults]
    what, costs = ", ".join(faults) or "healthy", f"cost {shown(one.cost)}, after fixes {shown(one.after)}"
    alarms = "".join(f"\n  false alarm: {alarm}" for alarm in one.false_alarms)
    return f"{one.seed}: {one.drive}: {what}; {costs}{alarms}{one.error}"


if __name__ == "__main__":
    run(InspectionFaults)
