"""`python -m experiments.live_faults --out live-faults`."""

import csv
import logging
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from rich.table import Table

from experiments.command import run
from experiments.live_faults.bench import Bench
from experiments.live_faults.faults import Fault, faults
from offpiste.core.errors import LiveError, OffpisteError
from offpiste.logs import open_log

logger = logging.getLogger("experiments")

_SEEN: Final = 1.5
"""The diagnostics of a fault are read for so long after it [s]."""


class Outcome(NamedTuple):
    """What came of a fault.

    Attributes:
        stopped_s: time until the stop was heard [s]; NaN where it drove on.
        named: the first line of the diagnostics that names it; empty for none.
        why: it was stopped first, as control says; empty where it was not, or another one stopped it.
        log: the recording of the drive.
    """

    fault: str
    repetition: int
    stopped_s: float
    named: str
    resumed: bool
    why: str
    log: str


@dataclass(frozen=True)
class LiveFaults:
    """Inject each fault at random moments of a drive, and tabulate what came of it; resumes where it stopped."""

    out: Path = Path("live-faults")
    """Folder of outcomes.csv, and of what each drive said and recorded."""
    repetitions: int = 20
    """Repetitions of each fault."""
    seed: int = 0
    """Seed of the moments, and of what is random in a fault."""
    world: str = "dunes"
    """World that is driven through."""
    speed: float = 2.0
    """Wanted [m/s]."""
    run_folder: str = "pretrained:proving-ground/b"
    """The run that drives."""
    only: tuple[str, ...] = ()
    """Faults whose name holds one of these."""
    wait_s: float = 60.0
    """A drive that has not resumed after so long does not resume [s]; its start may take three times as long."""

    def run(self) -> Table:
        """Drive, until each fault was made often enough."""
        self.out.mkdir(parents=True, exist_ok=True)
        wanted = [one for one in faults() if not self.only or any(part in one.name for part in self.only)]
        for number in count():
            left = self._left(wanted)
            if not left:
                return tabulate(self._outcomes(), self.out)
            self._drive(left, self.out / f"drive-{len(list(self.out.glob('drive-*')))}", number)
        raise AssertionError

    def _drive(self, left: Sequence[tuple[Fault, int]], folder: Path, number: int) -> None:
        """One drive, with a fault after the other until it ends.

        Raises:
            LiveError: it does not come to drive.
        """
        bench = Bench(folder, self.world, self.seed, self.speed, self.run_folder)
        try:
            if not bench.drives(3 * self.wait_s):
                raise LiveError(f"the vehicle does not come to drive: {bench.mode}", where=folder, how="see live.txt")
            for fault, repetition in left:
                rng = np.random.default_rng([self.seed, repetition, *fault.name.encode()])
                if not bench.drives(self.wait_s) or not _waited(bench, float(rng.uniform(0.5, 2.0))):
                    return
                outcome = self._made(fault, repetition, bench, rng)
                if outcome is None:
                    return
                self._keep(outcome)
                logger.info(f"{fault.name}: stop after {outcome.stopped_s:.2f} s, {outcome.named or 'not named'}")
                if not outcome.resumed or fault.ends_recording:
                    return
        finally:
            bench.end()

    def _made(self, fault: Fault, repetition: int, bench: Bench, rng: np.random.Generator) -> Outcome | None:
        """Make a fault; None where the course ended meanwhile."""
        began = bench.now
        lost = fault.inject(bench, rng)
        _waited(bench, _SEEN)
        resumed = bench.drives(self.wait_s)
        if not bench.runs:
            return None
        lines = sorted(line for line in bench.new_lines(began) if re.search(fault.named, line))
        named = lines[0] if lines else ""
        stopped = bench.stopped_after(lost)
        return Outcome(fault.name, repetition, stopped, named, resumed, bench.why(began), str(bench.recording))

    def _left(self, wanted: Sequence[Fault]) -> list[tuple[Fault, int]]:
        """Faults that are still to be made; those that end a drive come last."""
        made = {(one.fault, one.repetition) for one in self._outcomes()}
        left = [(one, k) for k in range(self.repetitions) for one in wanted if (one.name, k) not in made]
        return sorted(left, key=lambda pair: pair[0].ends_recording)

    def _outcomes(self) -> list[Outcome]:
        return list(_read(self.out / "outcomes.csv"))

    def _keep(self, outcome: Outcome) -> None:
        path = self.out / "outcomes.csv"
        with path.open("a", newline="", encoding="utf-8") as file:
            if not file.tell():
                csv.writer(file).writerow(Outcome._fields)
            csv.writer(file).writerow(outcome)


def _waited(bench: Bench, seconds: float) -> bool:
    """Whether the drive still runs after some time [s]."""
    bench.wait(seconds)
    return bench.runs


def _read(path: Path) -> Iterator[Outcome]:
    if not path.exists():
        return
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            number, stopped, resumed = int(row["repetition"]), float(row["stopped_s"]), row["resumed"] == "True"
            yield Outcome(row["fault"], number, stopped, row["named"], resumed, row["why"], row["log"])


def readable(log: str) -> bool:
    """Whether all files that a drive recorded can be read."""
    try:
        files = sorted(Path(log).parent.glob("*.mcap"))
        return bool(files) and all(open_log(file).topics for file in files)
    except OffpisteError:
        return False


def tabulate(outcomes: Sequence[Outcome], folder: Path) -> Table:
    """What came of each fault; also as table.md."""
    columns = (
        "fault",
        "times",
        "has to stop",
        "stop heard after, median / worst (s)",
        "drove on",
        "named",
        "resumed",
        "log readable",
    )
    rows, has_to_stop = [], {fault.name for fault in faults() if fault.stops}
    logs = {log: readable(log) for log in {one.log for one in outcomes}}
    for name in dict.fromkeys(one.fault for one in outcomes):
        of = [one for one in outcomes if one.fault == name]
        times = [one.stopped_s for one in of if np.isfinite(one.stopped_s)]
        stop = f"{np.median(times):.2f} / {max(times):.2f}" if times else ""
        shares = [len(of) - len(times), *(sum(map(bool, flags)) for flags in zip(
            *((one.named, one.resumed, logs[one.log]) for one in of), strict=True))]  # fmt: skip
        rows.append(
            (
                name,
                str(len(of)),
                "yes" if name in has_to_stop else "",
                stop,
                *(f"{share}/{len(of)}" for share in shares),
            )
        )
    lines = [columns, ("---",) * len(columns), *rows]
    (folder / "table.md").write_text("".join(f"| {' | '.join(line)} |\n" for line in lines), "utf-8")
    table = Table(*columns, box=None)
    for row in rows:
        table.add_row(*row)
    return table


if __name__ == "__main__":
    run(LiveFaults)
