"""Worlds of a file and of an extension."""

import pytest

from extending.outside import EXTENSIONS, succeeded
from offpiste.core.errors import OffpisteError
from offpiste.logs.ground_truth import GROUND_KINDS, read_truth_map
from offpiste.simulation.world.world import find_world_preset


@pytest.mark.parametrize(
    ("world", "extensions"), [(str(EXTENSIONS / "salt_flat.toml"), ""), ("salt-flat", "salt_flat")]
)
def test_a_drive_is_simulated_in_an_added_world(world, extensions, tmp_path):
    options = ("--sensors", "none", "--seconds", "1", "--out", tmp_path / "salt.mcap")
    succeeded("simulate", "--world", world, *options, extension=extensions)
    layers = read_truth_map(tmp_path / "salt.mcap").layers
    assert layers["elevation"].std() < 1.0  # hills of 0.3 m
    mean = {kind: layers[kind].mean() for kind in GROUND_KINDS}
    assert max(mean, key=mean.get) == "packed_sand"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "cannot read the world: No such file or directory"),
        ("hills = [", "not TOML"),
        ("hills = []", "missing required field `dunes`"),
        ("open_gruond = {}", "did you mean 'open_ground'"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line_that_names_it(text, message, tmp_path):
    file = tmp_path / "moon.toml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(OffpisteError, match=message) as caught:
        find_world_preset(str(file))
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)
