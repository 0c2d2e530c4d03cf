"""A long experiment as pieces: each is done whole and once, and a person sees how much is left."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path


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


def carry_out(
    pieces: Sequence[Piece],
    *,
    before: int = 0,
    later: Sequence[Piece] = (),
    tell: Callable[[str], None],
    record: Callable[[str, float], None] = lambda name, seconds: None,
    clock: Callable[[], float] = time.perf_counter,
) -> None:
    """Do what is not done yet, in order.

    Args:
        before: pieces that came first.
        later: pieces that come afterwards; they count for the time left.
        record: is told what each piece took [s].
    """
    total, began, spent = before + len(pieces) + len(later), clock(), 0.0
    for number, piece in enumerate(pieces):
        place = f"[{before + number + 1}/{total}] {piece.name}"
        if piece.done():
            tell(f"{place}: there")
            continue
        left = sum(p.cost for p in (*pieces[number:], *later) if not p.done())
        pace = (clock() - began) / spent if spent else 1.0
        tell(f"{place}; about {said(left * pace)} left")
        started = clock()
        piece.do()
        spent += piece.cost
        record(piece.name, clock() - started)
        tell(f"{' ' * len(place.partition(']')[0])}  done in {said(clock() - started)}")


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
