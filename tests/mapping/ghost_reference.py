"""The search for ghosts once more in plain NumPy: what the loops must agree with."""

import numpy as np

from offpiste.mapping.ghosts import HALF_OF_RINGS, GhostSettings


def found_ghosts(points: np.ndarray, sensor: np.ndarray, settings: GhostSettings) -> np.ndarray:
    """As `ghosts.GhostFinder.find`."""
    sectors, rings = settings.sectors, settings.rings
    with np.errstate(invalid="ignore", over="ignore"):
        x, y, z = (points - sensor).astype(np.float32).T
        r = np.sqrt(x * x + y * y)
        good = (np.abs(x) + np.abs(y) > 0.01) & (r < 1e4) & (np.abs(z) < 1e4)
    rows = np.flatnonzero(good)
    x, y, z, r = x[rows], y[rows], z[rows], r[rows]
    share = y / (np.abs(x) + np.abs(y))
    around = np.where(x >= 0, 1 + share, 3 - share)
    sector = np.minimum((around * np.float32(sectors / 4)).astype(int), sectors - 1)
    ring = np.minimum((rings * r / (r + np.float32(HALF_OF_RINGS))).astype(int), rings - 1)

    ground, away = _lowest(sector, ring, z, r, settings)
    slope = np.where(np.isfinite(ground), (ground - settings.depth) / away, -np.inf)
    pierced = np.zeros(len(z), bool)
    for i in range(len(z)):
        before = np.sort(slope[sector[i], : ring[i]])
        pierced[i] = len(before) > 1 and z[i] < before[-2] * r[i]

    clear = ~pierced
    ground, _ = _lowest(sector[clear], ring[clear], z[clear], r[clear], settings)
    result = np.zeros(len(points), bool)
    for i in np.flatnonzero(pierced):
        beside = np.arange(sector[i] - settings.window, sector[i] + settings.window + 1) % sectors
        along = slice(max(ring[i] - settings.window, 0), ring[i] + settings.window + 1)
        result[rows[i]] = not (ground[beside, along] <= z[i] + settings.depth).any()
    return result


def _lowest(sector, ring, z, r, settings):
    """Height of the lowest point of each cell, infinite in an empty one, and its distance."""
    ground = np.full((settings.sectors, settings.rings), np.inf)
    away = np.ones_like(ground)
    for i in np.argsort(-z, kind="stable"):
        ground[sector[i], ring[i]], away[sector[i], ring[i]] = z[i], r[i]
    return ground, away
