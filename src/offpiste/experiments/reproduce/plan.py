"""A long experiment as pieces: each is done whole and once, and a person sees how much is left."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass


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
    clock: Callable[[], float] = time.perf_counter,
) -> None:
    """Do what is not done yet, in order.

    Args:
        before: pieces that came first.
        later: pieces that come afterwards; they count for the time left.
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
        tell(f"{' ' * len(place.partition(']')[0])}  done in {said(clock() - started)}")


def said(seconds: float) -> str:
    """A length of time as a person says it."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
