"""Score `offpiste inspect` on logs with known faults: `python -m experiments.inspection_faults --out faults`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from experiments.command import run
from experiments.inspection_faults.faults import FAULTS, fault_named
from experiments.inspection_faults.report import report, shown
from experiments.inspection_faults.score import FaultCase, Score, fault_case, score
from experiments.inspection_faults.study import Study
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.render import render


@dataclass(frozen=True)
class InspectionFaults(Study):
    """Score inspect on simulated logs: a random vehicle, drive and logger each, healthy or with one to three faults."""

    out: Path = Path("inspection-faults")
    fault: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = ()
    """Faults to choose from, one per log; all, and some healthy logs, if none is given."""
    healthy: bool = False
    """Healthy logs only."""
    only: int | None = None
    """Score the log of this seed alone, and print its truth and its inspection."""
    list: bool = False
    """Print the names of the faults."""

    kind: ClassVar[type] = Score

    def run(self) -> str:
        """Score the logs that are missing, and report."""
        if self.list:
            return "\n".join(f"{one.name}: {', '.join(map(str, one.strengths))} {one.unit}" for one in FAULTS.values())
        for name in self.fault:
            fault_named(name)
        if self.only is None:
            return super().run()
        one = self.case(self.only)
        truth = ", ".join(map(str, (*one.given, *one.changes))) or "healthy"
        inspection = render(inspect_log(one.case.log, one.case.rig))
        return f"truth: {truth}\n{inspection}\n{self.summary(score(one))}"

    def case(self, seed: int) -> FaultCase:
        """The case of a seed."""
        return fault_case(seed, self.drives, self.fault, healthy=self.healthy)

    def score(self, seed: int) -> Score:
        """Score the case of a seed."""
        return score(self.case(seed))

    def report(self, scores: Sequence[Score]) -> str:
        """The whole report as Markdown."""
        return report(scores)

    def summary(self, score: Score) -> str:
        """A score in words; a false alarm a line."""
        found = [f"{f.name} ({f.strength:g}) {'found' if f.found else 'missed'} {f.first_fix}" for f in score.faults]
        what, costs = ", ".join(found) or "healthy", f"cost {shown(score.cost)}, after fixes {shown(score.after)}"
        alarms = "".join(f"\n  false alarm: {alarm}" for alarm in score.false_alarms)
        return f"{score.seed}: {score.drive}: {what}; {costs}{alarms}{score.error}"


if __name__ == "__main__":
    run(InspectionFaults)
