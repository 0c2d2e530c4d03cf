"""Build a world from its settings: trails, hills, kinds of ground, plants."""

import zlib

import numpy as np

from offpiste.core.errors import OffpisteError
from offpiste.simulation.world.forks import fork_trails, lay_forks
from offpiste.simulation.world.ground import grow_grass, lay_grounds, mix_properties, plant_bushes, plant_trees
from offpiste.simulation.world.terrain import SPACING, carve_trails, make_hills, make_trails, trail_distance_grid
from offpiste.simulation.world.world import BareTerrain, Fork, World, WorldSettings, find_world_preset

ALLOWED = {
    "seed": (0, np.inf, ""),
    "size": (60, 2000, " m"),  # a smaller world has no room for a trail
    "resolution": (0.05, 2, " m"),
    "grip_contrast": (0, 1, ""),
    "relief": (0, 5, ""),
    "appearance_noise": (0, 10, ""),
}
"""Lowest and highest settings, and their unit."""
_PARTS = ("trails", "hills", "carving", "grounds", "trees", "bushes", "grass", "forks")
"""Parts of a world with a random stream each, so that a change of one does not affect the others."""


def make_world(settings: WorldSettings) -> World:
    """Build a world; the same settings give the same bytes on the same machine.

    Raises:
        OffpisteError: a setting is out of range, or the preset does not exist.
    """
    preset = find_world_preset(settings.preset)
    _check(settings)
    of_preset = zlib.crc32(settings.name.encode())
    random = {part: np.random.default_rng([settings.seed, of_preset, i]) for i, part in enumerate(_PARTS)}

    nodes = round(settings.size / settings.resolution) + 1
    x = y = (np.arange(nodes) - (nodes - 1) / 2) * settings.resolution
    trails = make_trails(random["trails"], float(x[-1] - x[0]))
    forks: tuple[Fork, ...] = ()
    if settings.forks:
        trails, forks = fork_trails(random["forks"], trails, SPACING)
    trail_distance = trail_distance_grid(trails, x, y)
    hills = np.float32(settings.relief) * make_hills(random["hills"], preset, x, y)
    elevation = carve_trails(random["carving"], preset, x, y, hills, trails, trail_distance)
    bare = BareTerrain(x, y, elevation, trail_distance)
    kinds, wetness = lay_grounds(random["grounds"], preset, bare)
    lay_forks(random["forks"], forks, trails, bare, (kinds, wetness))
    properties = mix_properties(kinds, wetness, settings.grip_contrast * preset.grip)
    return World(
        settings=settings,
        origin=(float(x[0]), float(y[0])),
        resolution=settings.resolution,
        elevation=elevation,
        kinds=kinds,
        wetness=wetness,
        properties=properties,
        grass_height=grow_grass(random["grass"], preset, bare, kinds),
        trees=plant_trees(random["trees"], preset, bare),
        bushes=plant_bushes(random["bushes"], preset, bare),
        trails=trails,
        forks=forks,
    )


def _check(settings: WorldSettings) -> None:
    """Raise for the first setting out of range."""
    for name, (low, high, unit) in ALLOWED.items():
        if not low <= (value := getattr(settings, name)) <= high:
            how = f"choose {low:g} or more" if high == np.inf else f"choose {low:g} to {high:g}{unit}"
            raise OffpisteError(f"invalid {name} = {value}", where="world settings", how=how)
