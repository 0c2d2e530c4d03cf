"""Noise in the place of imperfect sight: its size, and that wheels and maps see the same."""

from pathlib import Path

import numpy as np
import pytest

from experiments.control_experiments.data import claim_drives, claim_settings, planned
from experiments.control_experiments.sweep import _named, draw_gains, noisy
from offpiste.dataset.splits import write_drives
from offpiste.errors import RunError
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.reproduction.gains import MAP, gain
from window_errors import BASE, errors


def kinds(nodes: int = 400) -> TerrainMap:
    features = np.random.default_rng(1).normal(size=(nodes, nodes, 2)) * [0.5, 3.0] + [0, 7]
    flat = np.zeros((nodes, nodes), np.float32)
    return TerrainMap(np.zeros(2), 0.5, flat, features.astype(np.float32))


def test_noise_has_the_stated_size_in_each_feature() -> None:
    seen = noisy(kinds(), 0.5, np.random.default_rng(2))
    added = seen.features - kinds().features
    assert added.std(axis=(0, 1)) == pytest.approx([0.25, 1.5], rel=0.15)
    assert np.abs(added.mean(axis=(0, 1)) / added.std(axis=(0, 1))).max() < 0.15
    # Smooth: neighbours half a metre apart have much the same.
    assert np.abs(np.diff(added[..., 0], axis=0)).mean() < 0.5 * added[..., 0].std()


def test_no_noise_leaves_the_map() -> None:
    np.testing.assert_array_equal(noisy(kinds(), 0.0, np.random.default_rng(2)).features, kinds().features)


def test_drives_are_named_and_seeded_in_order() -> None:
    drives = planned("mojave", ((10.0, 20.0), (), (30.0,)), seed=7, sensors="none", contrast=0.5)
    assert [(d.name, d.part, d.settings.seconds) for d in drives] == [
        ("mojave-7", "train", 10.0),
        ("mojave-8", "train", 20.0),
        ("mojave-9", "test", 30.0),
    ]
    assert {d.settings.world.grip_contrast for d in drives} == {0.5}
    assert [d.settings.world.seed for d in drives] == [7, 8, 9]


def test_gains_are_drawn_with_their_intervals() -> None:
    noise = np.random.default_rng(5).uniform(0.5, 1.0, len(BASE.row))
    one = gain("", "df", [errors(noise * BASE.distance())], [BASE], MAP)
    figure = draw_gains([(0.0, _named(one, "contrast 0")), (1.0, one)], "grip contrast")
    (axes,) = figure.axes
    assert axes.get_xlabel() == "grip contrast"
    (bars,) = axes.containers
    assert list(bars.lines[0].get_ydata()) == pytest.approx([100 * one.distance.mean] * 2)


def test_drives_that_are_there_are_not_reused_with_other_settings(tmp_path: Path, caplog) -> None:
    mine = planned("mojave", ((10.0, 20.0), (), (30.0,)), seed=7, sensors="none")
    claim_drives(tmp_path / "new", mine[:2])
    claim_drives(tmp_path / "new", mine)
    claim_drives(tmp_path / "new", mine[1:])
    with pytest.raises(RunError, match=r"new: drive 'mojave-8' was made with other settings \(part, seconds\); give"):
        claim_drives(tmp_path / "new", planned("mojave", ((10.0,), (30.0,), ()), seed=7, sensors="none"))
    with pytest.raises(RunError, match=r"'mojave-7' was made with other settings \(world.grip_contrast\)"):
        claim_drives(tmp_path / "new", planned("mojave", ((10.0,), (), ()), seed=7, sensors="none", contrast=0.5))
    assert not caplog.messages
    old = tmp_path / "old"
    write_drives(old / "parts.txt", ((drive.name, drive.part) for drive in mine))
    with pytest.raises(RunError, match=r"'mojave-8' was made with other settings \(part\)"):
        claim_drives(old, planned("mojave", ((10.0,), (30.0,), ()), seed=7, sensors="none"))
    caplog.clear()
    claim_drives(old, mine)
    assert "does not say how its drives were made" in caplog.text
    caplog.clear()
    claim_drives(old, mine)
    assert not caplog.messages


def test_settings_of_an_experiment_are_kept_with_it(tmp_path: Path, caplog) -> None:
    (tmp_path / "control.json").write_text("{}")
    claim_settings(tmp_path, {"seed": 0})
    assert "does not say what it was made with" in caplog.text
    with pytest.raises(RunError, match=r"was begun with other settings \(seed\)"):
        claim_settings(tmp_path, {"seed": 1})
