"""Forks: a trail splits into two ways around an island of open ground, one of them through mud.

Both ways have about the same length and bends, on either side of the former trail; a random draw decides which is
muddy. The other way is firm, like the trail before and behind, so that only the mud is hard to drive: it supports half
the lateral acceleration in bends. Mud is visible like any other ground.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.simulation.world.grids import Grid, Line, smooth_noise, smooth_step, turns_of
from offpiste.simulation.world.world import BareTerrain, Fork

LENGTH = 60.0
"""Length of trail that becomes two ways [m]."""
ASIDE = 8.0
"""Distance of either way from the former trail, in the middle [m]."""
WEAVE, WAVE = 1.2, 24.0
"""Amplitude and wavelength of the bends of both ways [m]; their smallest radii, 7 m, are like those of the trails."""
FREE = 12.0
"""Smallest distance of both ways from other trails [m]."""
TIGHTEST = 7.0
"""Smallest radius of a bend of either way [m]."""
MUD = (0.22, 0.78)
"""Section of the muddy way with mud; outside it, the ways are too close to each other."""
FIRM = 45.0
"""Length of firm trail before and behind a fork [m]."""
HALF_WIDTH = 4.0
"""Half the width of the mud and of firm ground [m]."""
KINDS = ("dirt_trail", "mud")
"""Kinds of firm ground and of mud."""
WETNESS = 0.6
"""Wetness of the mud."""


def fork_trails(
    rng: np.random.Generator, trails: tuple[Line, ...], spacing: float
) -> tuple[tuple[Line, ...], tuple[Fork, ...]]:
    """Add a fork to each trail, far from other trails, where both ways are most alike in length and bends.

    A trail without a suitable place is unchanged.

    Args:
        trails: closed loops.
        spacing: spacing of their points [m].

    Returns:
        the loops, starting with the left ways, then a closed loop of both ways for each fork.
    """
    count, forks = round(LENGTH / spacing), []
    for number, loop in enumerate(trails):
        others = [trail for k, trail in enumerate(trails) if k != number]
        starts = range(0, len(loop), round(5.0 / spacing)) if len(loop) > 4 * count else ()
        ways = {start: _ways(np.roll(loop, -start, axis=0)[: count + 1]) for start in starts}
        ways = {start: pair for start, pair in ways.items() if max(map(_sharpest, pair)) < 1 / TIGHTEST}
        if others:
            far = cKDTree(np.concatenate(others))
            ways = {start: pair for start, pair in ways.items() if far.query(np.concatenate(pair))[0].min() > FREE}
        if ways:
            start = min(ways, key=lambda k: unevenness(*ways[k]))
            forks.append(Fork(number, *ways[start], muddy=int(rng.integers(2))))
            trails = (
                *trails[:number],
                np.concatenate((ways[start][0], np.roll(loop, -start, axis=0)[count + 1 :])),
                *trails[number + 1 :],
            )
    islands = (np.concatenate((fork.right, fork.left[-2:0:-1])) for fork in forks)
    return (*trails, *islands), tuple(forks)


def lay_forks(
    rng: np.random.Generator,
    forks: tuple[Fork, ...],
    trails: tuple[Line, ...],
    bare: BareTerrain,
    ground: tuple[Float[np.ndarray, "K ny nx"], Grid],
) -> None:
    """Lay firm ground on and around both ways of each fork, and mud on one of them, in place.

    Args:
        trails: result of `fork_trails`.
        ground: kinds and wetness.
    """
    kinds, wetness = ground
    edge = 0.35 * smooth_noise(rng, bare.x, bare.y, 1.5) if forks else np.zeros(0)
    for fork in forks:
        trail, both = trails[fork.loop], (fork.left, fork.right)
        arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(trail, axis=0), axis=1))))
        around = trail[(arc < arc[len(fork.left) - 1] + FIRM) | (arc > arc[-1] - FIRM)]
        mud = both[fork.muddy][slice(*(round(share * len(fork.left)) for share in MUD))]
        for muddy, line in ((False, np.concatenate((around, fork.right))), (True, mud)):
            near, nodes = _around(line, bare)
            away = cKDTree(line).query(nodes)[0]
            share = smooth_step(away + edge[near], HALF_WIDTH + 0.5, HALF_WIDTH - 0.5)  # a border about 1 m wide
            if muddy:
                share *= away <= cKDTree(both[1 - fork.muddy]).query(nodes)[0]
                wetness[near] += share * (WETNESS - wetness[near])
            kinds[(slice(None), *near)] *= 1 - share
            kinds[(GROUND_KINDS.index(KINDS[muddy]), *near)] += share


def _around(
    line: Float[np.ndarray, "n 2"], bare: BareTerrain
) -> tuple[tuple[slice, slice], Float[np.ndarray, "ny nx 2"]]:
    """Return the slices of the rows and columns around a line, and the places of their nodes [m]."""
    low, high = line.min(axis=0) - 2 * HALF_WIDTH, line.max(axis=0) + 2 * HALF_WIDTH
    columns, rows = (slice(*np.searchsorted(at, (low[k], high[k]))) for k, at in enumerate((bare.x, bare.y)))
    return (rows, columns), np.stack(np.meshgrid(bare.x[columns], bare.y[rows]), axis=-1)


def _ways(trail: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Return two winding ways beside a piece of trail, which leave it gently; mirror images where it is straight."""
    ahead = np.gradient(trail, axis=0)
    left = np.stack((-ahead[:, 1], ahead[:, 0]), axis=1) / np.linalg.norm(ahead, axis=1, keepdims=True)
    share = np.linspace(0, 1, len(trail))
    aside = ASIDE + WEAVE * np.sin(2 * np.pi * LENGTH / WAVE * share)
    beside = (aside * np.sin(np.pi * share) ** 2)[:, None] * left
    return trail + beside, trail - beside


def unevenness(left: Float[np.ndarray, "n 2"], right: Float[np.ndarray, "n 2"]) -> float:
    """Return the difference of two ways in length [m] and total turning, where one radian counts as 5 m."""
    length, other = (np.linalg.norm(np.diff(way, axis=0), axis=1).sum() for way in (left, right))
    turning, its = (np.abs(turns_of(way)).sum() for way in (left, right))
    return float(abs(length - other) + 5.0 * abs(turning - its))


def _sharpest(way: Float[np.ndarray, "n 2"]) -> float:
    """Return the greatest curvature of a way [1/m]."""
    return float((np.abs(turns_of(way)) / np.linalg.norm(np.diff(way[1:], axis=0), axis=1)).max())
