"""Resumable steps of long experiments with an estimate of the remaining time."""

import io
import json
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from offpiste.core.errors import RunError
from offpiste.core.files import check_folder
from offpiste.core.parallel import Report, run_all
from offpiste.training.checkpoint import load_json, save_json

logger = logging.getLogger(__name__)


_NAMED = 6
"""Largest number of settings named in a message."""


def claim_folder(out: Path, settings: dict[str, Any], *, own: Sequence[str] = ("settings.json",)) -> None:
    """Write the settings of an experiment to `out/settings.json`, or check that they are unchanged.

    Args:
        own: patterns of files; a non-empty folder must hold one of them.

    Raises:
        RunError: the folder was begun with other settings.
        OffpisteError: it is a file, or holds other files.
    """
    check_folder(out, own=own)
    path, wanted = out / "settings.json", json.loads(json.dumps(settings))
    if not path.exists():
        save_json(path, wanted)
        return
    other = list(_differing("", load_json(path), wanted))
    if other:
        more = f" and {len(other) - _NAMED} more" if len(other) > _NAMED else ""
        raise RunError(
            f"was begun with other settings ({', '.join(other[:_NAMED])}{more})",
            where=out,
            how="give the same settings again, or choose another --out",
        )


def _differing(name: str, there: Any, wanted: Any) -> Iterator[str]:
    """Yield the names of differing settings, nested names with dots; settings that no longer exist are ignored."""
    if not (isinstance(there, dict) and isinstance(wanted, dict)):
        if there != wanted:
            yield name
        return
    for key in sorted(wanted):
        yield from _differing(f"{name}.{key}".lstrip("."), there.get(key), wanted.get(key))


Record = Callable[[str, float], None]
"""Receives the name and duration [s] of a step."""


@dataclass(frozen=True)
class Step:
    """Step of an experiment.

    Attributes:
        name: shown in the log.
        cost: estimated duration, relative to other steps [s].
        done: whether the result exists.
        do: makes the result, whole or not at all, or resumes.
        result: short description of the result, for the log of parallel steps.
    """

    name: str
    cost: float
    done: Callable[[], bool]
    do: Callable[[], None]
    result: Callable[[], str] = str


def run_steps(
    stages: Sequence[Sequence[Step]],
    *,
    before: int = 0,
    later: Sequence[Step] = (),
    processes: int = 1,
    record: Record | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> None:
    """Run the missing steps, stage after stage.

    Args:
        stages: steps of one stage do not depend on each other.
        before: number of earlier steps.
        later: later steps, included in the remaining time.
        processes: number of parallel steps of a stage; with more than one, `do` and `record` must be picklable.
        record: receives the duration of each step.

    Raises:
        OffpisteError: a step failed; other steps of its stage may have been done.
    """
    steps = [step for stage in stages for step in stage]
    pace = _Pace([*steps, *later], clock)
    total = before + len(steps) + len(later)
    numbers = {step.name: f"[{number}/{total}]" for number, step in enumerate(steps, start=before + 1)}
    for stage in stages:
        missing = [step for step in stage if not step.done()]
        for step in stage:
            if step not in missing:
                logger.info(f"{numbers[step.name]} {step.name}: there")
        if processes > 1 and len(missing) > 1:
            _side_by_side(missing, numbers, processes, pace, record)
            continue
        for step in missing:
            number = numbers[step.name]
            logger.info(f"{number} {step.name}; about {pace.left()} left")
            seconds = _timed(step.name, step.do, record, clock)
            pace.spent += step.cost
            logger.info(f"{' ' * len(number)} done in {format_duration(seconds)}")


class _Pace:
    """Estimate of the remaining time, from the duration of earlier steps."""

    def __init__(self, steps: Sequence[Step], clock: Callable[[], float]) -> None:
        self._steps, self._clock, self._began = steps, clock, clock()
        self.spent = 0.0

    def left(self) -> str:
        seconds = sum(step.cost for step in self._steps if not step.done())
        return format_duration(seconds * ((self._clock() - self._began) / self.spent if self.spent else 1.0))


def _side_by_side(
    steps: Sequence[Step], numbers: Mapping[str, str], processes: int, pace: _Pace, record: Record | None
) -> None:
    named = {step.name: step for step in steps}
    logger.info(f"{len(steps)} steps, {min(processes, len(steps))} at a time: {', '.join(named)}")

    def done(name: str) -> None:
        pace.spent += named[name].cost
        result = named[name].result()
        logger.info(f"{numbers[name]} {name}: done{result and f', {result}'}; about {pace.left()} left")

    work = partial(_alone, jobs={step.name: (step.do, record) for step in steps})
    run_all(work, list(named), processes, "steps", finished=done).checked()


def _alone(name: str, report: Report, *, jobs: Mapping[str, tuple[Callable[[], None], Record | None]]) -> str:
    with redirect_stderr(io.StringIO()):  # progress bars of several processes would overlap
        _timed(name, *jobs[name], time.perf_counter)
    return name


def _timed(name: str, do: Callable[[], None], record: Record | None, clock: Callable[[], float]) -> float:
    started = clock()
    do()
    seconds = clock() - started
    if record is not None:
        record(name, seconds)
    return seconds


def append_time(path: Path, name: str, seconds: float) -> None:
    """Append the duration of a step since it was last resumed."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps({"step": name, "seconds": round(seconds, 1)}) + "\n")


def times_by_kind(path: Path) -> dict[str, float]:
    """Return the total duration of steps by the first word of their names: simulate, train, ... [s]."""
    spent: dict[str, float] = {}
    lines = path.read_text("utf-8").splitlines() if path.exists() else []
    for line in lines:
        step = json.loads(line)
        kind = step["step"].split()[0]
        spent[kind] = spent.get(kind, 0.0) + step["seconds"]
    return spent


def format_duration(seconds: float) -> str:
    """Format a duration in seconds, minutes or hours."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
