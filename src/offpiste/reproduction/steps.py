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


@dataclass(frozen=True)
class Step:
    """Step of an experiment.

    Attributes:
        name: unique, shown in the log.
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
    stages: Sequence[Sequence[Step]], *, processes: int = 1, clock: Callable[[], float] = time.perf_counter
) -> None:
    """Run the missing steps, stage after stage, and log the remaining time.

    Args:
        stages: steps of one stage do not depend on each other.
        processes: number of parallel steps of a stage; with more than one, `do` must be picklable.

    Raises:
        OffpisteError: a step failed; other steps of its stage may have been done.
    """
    steps = {step.name: step for stage in stages for step in stage}
    number = {name: f"[{place}/{len(steps)}]" for place, name in enumerate(steps, start=1)}
    began, spent = clock(), 0.0

    def left() -> str:
        seconds = sum(step.cost for step in steps.values() if not step.done())
        return format_duration(seconds * ((clock() - began) / spent if spent else 1.0))

    def finished(name: str) -> None:
        nonlocal spent
        spent += steps[name].cost
        result = steps[name].result()
        logger.info(f"{number[name]} {name}: done{result and f', {result}'}; about {left()} left")

    for stage in stages:
        missing = {step.name: step.do for step in stage if not step.done()}
        for step in stage:
            if step.name not in missing:
                logger.info(f"{number[step.name]} {step.name}: there")
        if processes > 1 and len(missing) > 1:
            logger.info(f"{len(missing)} steps, {min(processes, len(missing))} at a time: {', '.join(missing)}")
            run_all(partial(_quietly, jobs=missing), list(missing), processes, "steps", finished=finished).checked()
            continue
        for name, do in missing.items():
            logger.info(f"{number[name]} {name}; about {left()} left")
            started = clock()
            do()
            spent += steps[name].cost
            logger.info(f"{' ' * len(number[name])} done in {format_duration(clock() - started)}")


def _quietly(name: str, report: Report, *, jobs: Mapping[str, Callable[[], None]]) -> str:
    with redirect_stderr(io.StringIO()):  # progress bars of several processes would overlap
        jobs[name]()
    return name


def format_duration(seconds: float) -> str:
    """Format a duration in seconds, minutes or hours."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
