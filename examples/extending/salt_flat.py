"""A world with a name of its own, from outside the package.

    OFFPISTE_EXTENSIONS=salt_flat PYTHONPATH=examples/extending offpiste simulate --world salt-flat

Worlds that differ in numbers only need no Python: `offpiste simulate --world salt_flat.toml` reads the file itself. The
name is part of a world's seed: the two commands lay other trails.
"""

from pathlib import Path

from offpiste.simulation.world.world import WORLDS, read_world_preset

WORLDS.register("salt-flat")(read_world_preset(Path(__file__).with_suffix(".toml")))
