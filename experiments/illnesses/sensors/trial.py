"""The command that scores the checks of cameras and LiDARs on simulated logs with known truth.

Each seed is one log: a drive on the proving ground with one camera and one LiDAR, healthy or with one illness at graded
strength. Five seeds share a drive.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from experiments.illnesses import results
from experiments.illnesses.sensors.declarations import SENSOR_ILLNESSES
from experiments.illnesses.sensors.score import SensorScore, patient, score
from experiments.illnesses.sensors.table import report
from offpiste.core.files import check_folder


@dataclass(frozen=True)
class SensorIllnesses:
    """Score the checks of cameras and LiDARs on simulated logs.

    Attributes:
        out: folder of results: a JSON line for each log, and report.md; what is there is not done again.
        logs: number of logs; those whose seed is a multiple of 5 are healthy.
        seed: of the first log; the others follow.
        illness: illnesses to choose from; all if none is given.
        processes: logs at a time.
        cache: folder of simulated drives; OUT/drives if not given.
        only: run the log of this seed alone, and print its truth and the findings.
        list: print the names of the illnesses.
    """

    out: Path = Path("sensor-illnesses")
    logs: int = 60
    seed: int = 1
    illness: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = ()
    processes: int = 1
    cache: Path | None = None
    only: int | None = None
    list: bool = False

    def run(self) -> str:
        """Run the logs that are missing, and report."""
        if self.list:
            return "\n".join(
                f"{name}: {', '.join(map(str, one.strengths))} {one.unit}" for name, one in SENSOR_ILLNESSES.items()
            )
        check_folder(self.out)
        for name in self.illness:
            SENSOR_ILLNESSES[name]
        if self.only is not None:
            one = patient(self.only, self.drives, names=self.illness)
            result = score(one)
            lines = (*result.findings, *((result.error,) if result.error else ()))
            verdict = f"found {result.found}, noted {result.noted}, first cure {result.cure or '-'}"
            return "\n".join((f"truth: {one}; {one.drive.behaviour}, {one.drive.layout}", *lines, verdict))
        seeds = range(self.seed, self.seed + self.logs)
        work = partial(_work, self)
        return results.reported(self.scores, SensorScore, seeds, work, report, processes=self.processes)

    @property
    def drives(self) -> Path:
        """Folder of simulated drives."""
        return self.cache or self.out / "drives"

    @property
    def scores(self) -> Path:
        """File of scores."""
        return self.out / "scores.jsonl"


def _work(settings: SensorIllnesses, seed: int, progress: Callable[[float], None]) -> str:
    one = patient(seed, settings.drives, names=settings.illness)
    result = score(one)
    results.append(settings.scores, result)
    what = "FOUND" if result.found else "noted" if result.noted else "missed" if result.illness else ""
    verdict = " ".join(filter(None, (what, result.cure)))
    return f"{seed}: {one}; {one.drive.behaviour}, {one.drive.layout}: {verdict}; {len(result.alarms)} other alarms"
