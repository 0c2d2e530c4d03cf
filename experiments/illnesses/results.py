"""Scores of finished logs, a JSON line each: what an interruption leaves is read again."""

from pathlib import Path
from typing import Any, TypeVar

import msgspec

T = TypeVar("T")


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
