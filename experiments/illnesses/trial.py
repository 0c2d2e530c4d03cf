"""The command that scores `offpiste inspect` on simulated logs with known truth.

Each seed is one log: a drive of a vehicle drawn at random on the proving ground (no cameras, no LiDAR), recorded by a
logger drawn at random, healthy or with one to three illnesses at graded strength.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import tyro

from experiments.illnesses import results
from experiments.illnesses.cases import Patient, patient
from experiments.illnesses.formats import formats_for, stored
from experiments.illnesses.illness import ILLNESSES
from experiments.illnesses.score import Score, score
from experiments.illnesses.table import report, shown
from offpiste.core.files import check_folder
from offpiste.core.progress import show
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.render import render


@dataclass(frozen=True)
class Illnesses:
    """Score inspect on simulated logs.

    Attributes:
        out: folder of results: a JSON line for each log, and report.md; what is there is not done again.
        logs: number of logs.
        seed: of the first log; the others follow.
        illness: illnesses to choose from, one a log; all, and some healthy logs, if none is given.
        healthy: healthy logs only.
        processes: logs at a time.
        files: share of the logs that are written to a file and read again.
        cache: folder of simulated drives; OUT/drives if not given.
        only: run the log of this seed alone, and print its truth and the inspection.
        list: print the names of the illnesses.
    """

    out: Path = Path("illnesses")
    logs: int = 200
    seed: int = 1
    illness: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = ()
    healthy: bool = False
    processes: int = 1
    files: float = 0.2
    cache: Path | None = None
    only: int | None = None
    list: bool = False

    def run(self) -> str | None:
        """Run the logs that are missing, and report."""
        if self.list:
            return "\n".join(f"{one.kind}: {name}: {', '.join(map(str, one.strengths))} {one.unit}"
                             for name, one in ILLNESSES.items())  # fmt: skip
        check_folder(self.out)
        for name in self.illness:
            ILLNESSES[name]
        if self.only is not None:
            self._show(self.only)
            return None
        seeds = range(self.seed, self.seed + self.logs)
        scores = self.out / "scores.jsonl"
        return results.reported(scores, Score, seeds, partial(_work, self), report, processes=self.processes)

    @property
    def drives(self) -> Path:
        """Folder of simulated drives."""
        return self.cache or self.out / "drives"

    def patient(self, seed: int) -> Patient:
        """The case of a seed."""
        return patient(seed, self.drives, names=self.illness, healthy=self.healthy)

    def _show(self, seed: int) -> None:
        one = self.patient(seed)
        result = _scored(self, one)
        show("truth: " + (", ".join(map(str, one.given)) or "healthy"))
        show(f"{result.body}, {result.behaviour}, {result.storage}; channels: {', '.join(one.case.rig.channels)}")
        if result.error:
            show(result.error)
            return
        show(render(inspect_log(one.case.log, one.case.rig)))
        cost, after = (shown(value) for value in (result.cost, result.after))
        show(f"cost {cost}, after cures {after}, distance {result.distance:.3f}")
        for ill in result.illnesses:
            show(f"{ill.name}: found {ill.found}, noted {ill.noted}, first cure {ill.first_cure or '-'}")
        for alarm in result.false_alarms:
            show(f"false alarm: {alarm}")


def _scored(settings: Illnesses, one: Patient) -> Score:
    random = np.random.default_rng([one.seed, 0xF11E])
    if random.random() >= settings.files:
        return score(one, one.case.log, storage="memory")
    storage = str(random.choice(formats_for(one.case)))
    with TemporaryDirectory(prefix="illnesses-") as folder:
        case, log = stored(one.case, storage, Path(folder))
        return score(replace(one, case=case), log, storage=storage)


def _work(settings: Illnesses, seed: int, progress: Callable[[float], None]) -> str:
    one = settings.patient(seed)
    result = _scored(settings, one)
    results.append(settings.out / "scores.jsonl", result)
    what = ", ".join(f"{i.name} ({i.strength:g}) {'found' if i.found else 'MISSED'}" for i in result.illnesses)
    return f"{seed}: {what or 'healthy'}; cost {shown(result.cost)}; {len(result.false_alarms)} false alarms"
