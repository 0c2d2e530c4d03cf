"""Scores of finished logs, one JSON line each, so that an interrupted run resumes."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from offpiste.core.errors import OffpisteError
from offpiste.core.files import write_text
from offpiste.core.parallel import run_all

T = TypeVar("T")


def reported(
    out: Path,
    kind: type[T],
    seeds: Sequence[int],
    work: Callable[[int, Callable[[float], None]], str],
    report: Callable[[Sequence[T]], str],
    *,
    processes: int,
) -> str:
    """Make the scores that `scores.jsonl` lacks, and write and return the report on all seeds.

    Args:
        work: appends the score of a seed to the file.

    Raises:
        OffpisteError: some could not be made.
    """
    done = _read(out, kind)
    missing = [seed for seed in seeds if seed not in done]
    failed = run_all(work, missing, processes, out.name).failed
    if failed:
        raise OffpisteError(f"{len(failed)} of {len(missing)} logs could not be made", where=out)
    done = _read(out, kind)
    text = report([done[seed] for seed in seeds])
    write_text(out / "report.md", text)
    return text


def append(out: Path, score: Any) -> None:
    """Add a score in one write of a whole line, so that processes do not mix them."""
    with (out / "scores.jsonl").open("ab", buffering=0) as file:
        file.write(msgspec.json.encode(score) + b"\n")


def _read(out: Path, kind: type[T]) -> dict[int, T]:
    """Scores by seed, without a line that an interruption cut off."""
    path, scores = out / "scores.jsonl", {}
    for line in path.read_text("utf-8").splitlines() if path.exists() else ():
        try:
            one: Any = msgspec.json.decode(line, type=kind)
        except msgspec.DecodeError:
            continue
        scores[one.seed] = one
    return scores
