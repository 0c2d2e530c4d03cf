"""A folder that belongs to an experiment with these settings, and to no other.

A long experiment as pieces: each is done whole and once, and a person sees how much is left.
"""

import io
import json
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from offpiste.errors import RunError
from offpiste.parallel import Report, run_all
from offpiste.training.checkpoint import load_json, save_json

logger = logging.getLogger(__name__)


def claim_folder(out: Path, described: dict[str, Any]) -> None:
    """Say in `out/settings.json` what the folder is of, or check that it is of this.

    Raises:
        RunError: it was begun with other settings.
    """
    path, described = out / "settings.json", json.loads(json.dumps(described))
    if not path.exists():
        save_json(path, described)
        return
    found = load_json(path)
    other = [key for key in sorted({*found, *described}) if found.get(key) != described.get(key)]
    if other:
        other = [name for key in other for name in _differing(key, found.get(key), described.get(key))]
        raise RunError(
            f"was begun with other settings ({', '.join(other)})",
            where=out,
            how="give the same again, or choose another --out",
        )


def _differing(name: str, found: Any, asked: Any) -> list[str]:
    """Names of what differs, inside of a table of settings by its own keys."""
    if not (isinstance(found, dict) and isinstance(asked, dict)):
        return [name]
    return [f"{name}.{key}" for key in sorted({*found, *asked}) if found.get(key) != asked.get(key)]


Record = Callable[[str, float], None]
"""Is told what a piece took [s]."""


@dataclass(frozen=True)
class Piece:
    """A piece of work.

    Attributes:
        name: for a person.
        cost: how long it takes, roughly and only in proportion to others [s].
        done: whether what it makes is there.
        do: makes it, whole or not at all, or goes on with it.
    """

    name: str
    cost: float
    done: Callable[[], bool]
    do: Callable[[], None]


def nothing(name: str, seconds: float) -> None:
    """Record nothing."""


def run_pieces(
    stages: Sequence[Sequence[Piece]],
    *,
    before: int = 0,
    later: Sequence[Piece] = (),
    processes: int = 1,
    record: Record = nothing,
    clock: Callable[[], float] = time.perf_counter,
) -> None:
    """Do what is not done yet, stage after stage.

    Args:
        stages: pieces of one stage need nothing of each other.
        before: pieces that came first.
        later: pieces that come afterwards; they count for the time left.
        processes: with more than one, so many pieces of a stage are done side by side; then `do` and `record` must
            be what another process can be sent.
        record: is told what each piece took [s].

    Raises:
        OffpisteError: of a piece; others of its stage may have been done nevertheless.
    """
    pieces = [piece for stage in stages for piece in stage]
    pace = _Pace([*pieces, *later], clock)
    total = before + len(pieces) + len(later)
    numbers = {piece.name: f"[{number}/{total}]" for number, piece in enumerate(pieces, start=before + 1)}
    for stage in stages:
        missing = [piece for piece in stage if not piece.done()]
        for piece in stage:
            if piece not in missing:
                logger.info(f"{numbers[piece.name]} {piece.name}: there")
        if processes > 1 and len(missing) > 1:
            _side_by_side(missing, numbers, processes, pace, record)
            continue
        for piece in missing:
            number = numbers[piece.name]
            logger.info(f"{number} {piece.name}; about {pace.left()} left")
            seconds = _timed(piece.do, clock)
            record(piece.name, seconds)
            pace.spent += piece.cost
            logger.info(f"{' ' * len(number)} done in {said(seconds)}")


class _Pace:
    """How long what is left will take, from how long was needed for what is done."""

    def __init__(self, pieces: Sequence[Piece], clock: Callable[[], float]) -> None:
        self._pieces, self._clock, self._began = pieces, clock, clock()
        self.spent = 0.0

    def left(self) -> str:
        seconds = sum(piece.cost for piece in self._pieces if not piece.done())
        return said(seconds * ((self._clock() - self._began) / self.spent if self.spent else 1.0))


def _side_by_side(
    pieces: Sequence[Piece],
    numbers: Mapping[str, str],
    processes: int,
    pace: _Pace,
    record: Record,
) -> None:
    named = {piece.name: piece for piece in pieces}
    logger.info(f"{len(pieces)} pieces, {min(processes, len(pieces))} at a time: {', '.join(named)}")

    def done(name: str) -> None:
        if name not in named:  # a failure, which has its own words
            logger.info(name)
            return
        pace.spent += named[name].cost
        logger.info(f"{numbers[name]} {name}: done; about {pace.left()} left")

    failed = run_all(
        _alone, [_Job(piece.name, piece.do, record) for piece in pieces], processes, "pieces", finished=done
    )
    if failed:
        raise failed[0]


@dataclass(frozen=True)
class _Job:
    name: str
    do: Callable[[], None]
    record: Record


def _alone(job: _Job, report: Report) -> str:
    with redirect_stderr(io.StringIO()):  # bars of several processes would run into each other
        job.record(job.name, _timed(job.do, time.perf_counter))
    return job.name


def _timed(do: Callable[[], None], clock: Callable[[], float]) -> float:
    started = clock()
    do()
    return clock() - started


def append_time(path: Path, name: str, seconds: float) -> None:
    """Note what a piece took; one that was interrupted is noted only from where it went on."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps({"piece": name, "seconds": round(seconds, 1)}) + "\n")


def times_by_kind(path: Path) -> dict[str, float]:
    """Seconds spent by the first word of pieces' names: simulate, train, ..."""
    spent: dict[str, float] = {}
    lines = path.read_text("utf-8").splitlines() if path.exists() else []
    for line in lines:
        piece = json.loads(line)
        kind = piece["piece"].split()[0]
        spent[kind] = spent.get(kind, 0.0) + piece["seconds"]
    return spent


def said(seconds: float) -> str:
    """A length of time as a person says it."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
