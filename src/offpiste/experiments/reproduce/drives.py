"""Which drives are simulated: the paper's environments in the paper's shares, every drive in a world of its own."""

import math
from collections.abc import Iterator
from itertools import count

from offpiste.conventions import DT
from offpiste.dataset.splits import GAP, PARTS
from offpiste.experiments.recorded import PlannedDrive
from offpiste.experiments.reproduce.settings import Size
from offpiste.simulation.simulate import DriveSettings
from offpiste.simulation.world import WorldSettings

MIX = {"mojave": 0.64, "halter-ranch": 0.28, "dunes": 0.04, "coastal-scrub": 0.04}
"""Shares of the data by environment (paper, section V)."""

BLOCKS = "blocks:0.7,0.1,0.2"
"""How logs are cut where training and test come from the same ones."""

SHORTEST_CUT = 2 * GAP * DT / 0.1 + 5.0
"""A drive that is cut must have a validation stretch of two windows and more [s]."""

FIRST_SEED = 1000


def planned_drives(size: Size, *, same_logs: bool = False, contrast: float = 1.0) -> list[PlannedDrive]:
    """All drives; no two have the same seed.

    Args:
        same_logs: training and test from the same logs.
        contrast: of grip.
    """
    seeds = count(FIRST_SEED)
    parts = {"": sum(size.seconds)} if same_logs else dict(zip(PARTS, size.seconds, strict=True))
    shortest = max(size.shortest, SHORTEST_CUT) if same_logs else size.shortest
    return [
        PlannedDrive(_settings(size, world, next(seeds), seconds, contrast), part)
        for part, total in parts.items()
        for world, seconds in _shared(total, shortest, max(size.longest, shortest))
    ]


def seconds_of(drives: list[PlannedDrive]) -> float:
    """How long they last together [s]."""
    return sum(drive.settings.seconds for drive in drives)


def _shared(total: float, shortest: float, longest: float) -> Iterator[tuple[str, float]]:
    """World and length of each drive [s]."""
    for world, share in MIX.items():
        mine = max(share * total, shortest)
        number = max(1, min(math.ceil(mine / longest), math.floor(mine / shortest)))
        for _ in range(number):
            yield world, round(mine / number, 2)


def _settings(size: Size, world: str, seed: int, seconds: float, contrast: float) -> DriveSettings:
    where = WorldSettings(world, seed, contrast, size=size.world_size, resolution=size.world_resolution)
    return DriveSettings(where, seconds, seed, sensors="light")
