"""Scores of finished logs, a JSON line each: what an interruption leaves is read again."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from offpiste.core.errors import OffpisteError
from offpiste.core.files import write_text
from offpiste.core.parallel import run_all

T = TypeVar("T")


def reported(
    path: Path,
    kind: type[T],
    seeds: Sequence[int],
    work: Callable[[int, Callable[[float], None]], str],
    report: Callable[[Sequence[T]], str],
    *,
    processes: int,
) -> str:
    """The report on all seeds, in their order; scores that the file lacks are made first, and report.md is written.

    Args:
        path: of the scores.
        work: appends the score of a seed to the file.
        processes: seeds at a time.

    Raises:
        OffpisteError: some could not be made.
    """
    done = read(path, kind)
    missing = [seed for seed in seeds if seed not in done]
    failed = run_all(work, missing, processes, path.parent.name).failed
    if failed:
        raise OffpisteError(f"{len(failed)} of {len(missing)} logs could not be made", where=path.parent)
    done = read(path, kind)
    text = report([done[seed] for seed in seeds])
    write_text(path.parent / "report.md", text)
    return text


def append(path: Path, score: Any) -> None:
    """Add a score, in one write of a whole line, so that processes do not mix them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("ab", buffering=0) as file:
        file.write(msgspec.json.encode(score) + b"\n")


def read(path: Path, kind: type[T]) -> dict[int, T]:
    """Scores by seed; a line that an interruption cut off is left out."""
    scores: dict[int, T] = {}
    for line in path.read_text("utf-8").splitlines() if path.exists() else ():
        try:
            one: Any = msgspec.json.decode(line, type=kind)
        except msgspec.DecodeError:
            continue
        scores[one.seed] = one
    return scores
