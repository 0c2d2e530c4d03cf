"""Misspelled keys in files of worlds and vehicles; tests/rig has those of rigs."""

import pytest

from offpiste.core.errors import OffpisteError
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.world.world import read_world_preset


@pytest.mark.parametrize(
    ("read", "text", "meant"),
    [(load_vehicle, "wheelbsae = 2.0", "wheelbase"), (read_world_preset, "open_gruond = {}", "open_ground")],
)
def test_a_misspelled_key_is_answered_by_the_nearest_one(read, text, meant, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(OffpisteError, match=f"did you mean '{meant}'"):
        read(path)
