"""Cases by seed: a drive, its recording, and none to three illnesses."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from experiments.illnesses import channel_illnesses, pose_illnesses, rig_illnesses, stamp_illnesses  # noqa: F401
from experiments.illnesses.drives import drive_of
from experiments.illnesses.illness import ILLNESSES, Illness
from experiments.illnesses.logger import recorded
from experiments.illnesses.recording import Case
from experiments.illnesses.true_drive import TrueDrive

_HEALTHY: Final = 0.3
"""Share of the healthy cases, where no illness is asked for."""
_EITHER: Final = ({"orientation", "yaw"}, {"yaw_rate", "angular_velocity"}, {"yaw", "angular_velocity"})
"""Channels of which a recording has one."""
_SEVERAL: Final = (0.8, 0.13, 0.07)
"""Shares of one, two and three illnesses."""


@dataclass(frozen=True)
class Given:
    """An illness at a strength."""

    illness: Illness
    strength: float

    def __str__(self) -> str:
        return f"{self.illness.name} ({self.strength:g} {self.illness.unit})".replace(" )", ")")


@dataclass(frozen=True)
class Patient:
    """A case with its truth.

    Attributes:
        case: as it is inspected.
        healthy: before any illness.
        given: the illnesses, in the order in which they were applied; those of kind "healthy" are none.
    """

    seed: int
    drive: TrueDrive
    case: Case
    healthy: Case
    given: tuple[Given, ...]

    @property
    def illnesses(self) -> tuple[Given, ...]:
        """What is wrong."""
        return tuple(given for given in self.given if given.illness.kind != "healthy")

    @property
    def conventional(self) -> Case:
        """The healthy case by the conventions of the case: as a vehicle records on that has these alone."""
        case = self.healthy
        for given in self.illnesses:
            if given.illness.convention:
                case = given.illness.change(case, given.strength, np.random.default_rng(self.seed))
        return case


def patient(seed: int, cache: Path, *, names: Sequence[str] = (), healthy: bool = False) -> Patient:
    """The case of a seed.

    Args:
        cache: folder of simulated drives.
        names: illnesses to choose from, one a case; all by default, and then some cases are healthy or have several.
        healthy: no illness, but perhaps a change of kind "healthy".
    """
    random = np.random.default_rng([seed, 0x111])
    given = _drawn(random, names, healthy=healthy)
    drive = drive_of(seed, cache)
    needs = {channel for one in given for channel in one.illness.needs}
    case = well = recorded(drive, random, needs)
    for one in given:
        case = one.illness.change(case, one.strength, random)
        if one.illness.kind == "healthy":
            well = case
    return Patient(seed, drive, case, well, given)


def _drawn(random: np.random.Generator, names: Sequence[str], *, healthy: bool) -> tuple[Given, ...]:
    everything = [one for _, one in ILLNESSES.items()]
    harmless = [one for one in everything if one.kind == "healthy"]
    if healthy or (not names and random.random() < _HEALTHY):
        return _some(random, harmless, 1) if random.random() < 0.3 else ()
    if names:
        return _some(random, [ILLNESSES[name] for name in names], 1)
    count = 1 + int(random.choice(len(_SEVERAL), p=_SEVERAL))
    return _some(random, [one for one in everything if one.kind != "healthy"], count)


def _some(random: np.random.Generator, choices: Sequence[Illness], count: int) -> tuple[Given, ...]:
    """Illnesses that do not share a place, so that each can be recognised, at any of their strengths."""
    chosen: list[Illness] = []
    for number in random.permutation(len(choices)):
        one = choices[int(number)]
        taken = {place for other in chosen for place in (*other.places, *other.needs)}
        if not taken & {*one.places, *one.needs} and not _clash(one, chosen):
            chosen.append(one)
        if len(chosen) == count:
            break
    return tuple(Given(one, float(random.choice(one.strengths))) for one in chosen)


def _clash(one: Illness, others: Sequence[Illness]) -> bool:
    """Whether a recording cannot have what both need."""
    needed = {channel for illness in (one, *others) for channel in illness.needs}
    return any(pair <= needed for pair in _EITHER)
