"""Studies of many simulated logs: a JSON line per log, so that an interrupted run resumes, and a report."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import msgspec

from offpiste.core.errors import OffpisteError
from offpiste.core.files import check_folder, write_text
from offpiste.core.parallel import run_all


@dataclass(frozen=True)
class Study(ABC):
    """Score simulated logs."""

    out: Path
    """Folder of results: a JSON line per log, and report.md; finished logs are not repeated."""
    logs: int = 200
    """Number of logs."""
    seed: int = 1
    """Seed of the first log; the others follow."""
    processes: int = 1
    """Logs at a time."""
    cache: Path | None = None
    """Folder of simulated drives; OUT/drives if not given."""

    kind: ClassVar[type]
    """Type of a score."""

    @abstractmethod
    def score(self, seed: int) -> Any:
        """Return the score of a log."""

    @abstractmethod
    def report(self, scores: Sequence[Any]) -> str:
        """Return the report as Markdown."""

    @abstractmethod
    def summary(self, score: Any) -> str:
        """Return a score in one line."""

    @property
    def drives(self) -> Path:
        """Folder of simulated drives."""
        return self.cache or self.out / "drives"

    def run(self) -> str:
        """Score the logs that are missing; write and return the report on all seeds.

        Raises:
            OffpisteError: some could not be scored.
        """
        check_folder(self.out)
        self.out.mkdir(parents=True, exist_ok=True)
        seeds, done = range(self.seed, self.seed + self.logs), self._done()
        missing = [seed for seed in seeds if seed not in done]
        failed = run_all(partial(_work, self), missing, self.processes, self.out.name).failed
        if failed:
            raise OffpisteError(f"{len(failed)} of {len(missing)} logs could not be scored", where=self.out)
        done = self._done()
        text = self.report([done[seed] for seed in seeds])
        write_text(self.out / "report.md", text)
        return text

    def _done(self) -> dict[int, Any]:
        """Scores by seed, without a line that an interruption cut off."""
        path, scores = self.out / "scores.jsonl", {}
        for line in path.read_text("utf-8").splitlines() if path.exists() else ():
            try:
                one: Any = msgspec.json.decode(line, type=self.kind)
            except msgspec.DecodeError:
                continue
            scores[one.seed] = one
        return scores


def _work(study: Study, seed: int, progress: Callable[[float], None]) -> str:
    score = study.score(seed)
    with (study.out / "scores.jsonl").open("ab", buffering=0) as file:  # whole lines, so that processes do not mix them
        file.write(msgspec.json.encode(score) + b"\n")
    return study.summary(score)
