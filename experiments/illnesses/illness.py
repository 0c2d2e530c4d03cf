"""Illnesses: each is declared once, with its strengths, the places a finding may point to, and what it changes."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from experiments.illnesses.recording import Case
from offpiste.core.errors import OffpisteError
from offpiste.core.registry import Registry

Kind = Literal["channel", "stamps", "pose", "rig", "healthy"]
Change = Callable[[Case, float, np.random.Generator], Case]


@dataclass(frozen=True)
class Illness:
    """What is wrong with a recording or its rig.

    Attributes:
        kind: what it changes; "healthy" for changes that are no illness: no finding may point to them.
        unit: of the strengths.
        strengths: graded, the weakest first.
        places: channels that a finding may point to; their topics count as well.
        consequences: channels in which it may show too; a finding there neither finds it nor is a false alarm.
        needs: channels, and more, that the recording must have (`logger.Logger`).
        curable: whether entries of the rig undo it.
        convention: whether it is a constant scale of a quantity without a unit: any is right that is the same
            everywhere, where a model is trained and where it drives.
        change: the case with the illness of a strength.
    """

    name: str
    kind: Kind
    unit: str
    strengths: tuple[float, ...]
    places: tuple[str, ...]
    consequences: tuple[str, ...]
    needs: tuple[str, ...]
    curable: bool
    convention: bool
    change: Change


class UnknownIllness(OffpisteError):
    """There is no illness of this name."""


ILLNESSES: Final[Registry[Illness]] = Registry("illness", error=UnknownIllness)
"""All illnesses by name."""


def illness(
    name: str,
    kind: Kind,
    strengths: tuple[float, ...],
    unit: str,
    places: tuple[str, ...],
    *,
    consequences: tuple[str, ...] = (),
    needs: tuple[str, ...] | None = None,
    curable: bool = False,
    convention: bool = False,
) -> Callable[[Change], Change]:
    """Declare the illness that the decorated function makes; see `Illness`.

    Args:
        needs: `places` where it is not given.
    """

    def declare(change: Change) -> Change:
        wanted = places if needs is None else needs
        one = Illness(name, kind, unit, strengths, places, consequences, wanted, curable, convention, change)
        ILLNESSES.register(name)(one)
        return change

    return declare


def some_rows(count: int, length: int, random: np.random.Generator) -> slice:
    """A run of rows within the middle 80 % of a recording."""
    length = min(length, max(count // 4, 1))
    first = int(random.integers(count // 10, max(9 * count // 10 - length, count // 10 + 1)))
    return slice(first, first + length)
