"""Differences between twins: made-up ones with a known answer, and a vehicle that parts from its drive."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.control_experiments import twins
from experiments.control_experiments.branches import branches_of, load_branches, save_branches, twin_worlds
from experiments.control_experiments.sensitivity import Differences, draw_sensitivity, sensitivity, sensitivity_table
from experiments.control_experiments.twins import settings_of
from offpiste.conventions import DT
from offpiste.reproduction.data import planned_drives
from offpiste.reproduction.settings import SIZES
from offpiste.rig.rig import load_rig
from offpiste.simulation.simulate import DriveSettings
from offpiste.simulation.world.world import WorldSettings


def made(slope: float, noise: float, *, count: int = 400) -> Differences:
    rng = np.random.default_rng(3)
    simulated = rng.normal(size=(count, 2)) * [2.0, 0.5]
    row = np.arange(count) * 50
    return Differences(np.zeros(count, int), row, simulated, slope * simulated + noise * rng.normal(size=(count, 2)))


def test_a_model_that_is_the_simulator() -> None:
    measured = sensitivity("dc", made(1.0, 0.0))
    for value, wanted in ((measured.slope, 1.0), (measured.correlation, 1.0), (measured.left_over, 0.0)):
        assert value.mean == pytest.approx(wanted, abs=1e-12)
        assert value.ci95 == pytest.approx((wanted, wanted), abs=1e-7)
    assert measured.simulated_rms_m == pytest.approx(np.sqrt(4.25), rel=0.1)


def test_half_the_difference_with_noise() -> None:
    # Variances by hand: s 4.25, p = s / 2 + noise of 1 each way: correlation 2.125 / sqrt(4.25 x (1.0625 + 2)).
    measured = sensitivity("dc", made(0.5, 1.0, count=4000))
    assert measured.slope.ci95[0] < 0.5 < measured.slope.ci95[1]
    assert measured.correlation.mean == pytest.approx(2.125 / np.sqrt(4.25 * 3.0625), abs=0.03)
    assert measured.correlation_ahead.mean == pytest.approx(2 / np.sqrt(4 * 2), abs=0.03)
    assert measured.left_over.mean == pytest.approx(np.sqrt((0.25 * 4.25 + 2) / 4.25), abs=0.03)


def test_a_model_that_tells_nothing_apart() -> None:
    measured = sensitivity("b", made(0.0, 0.0))
    assert (measured.slope.mean, measured.left_over.mean) == (0.0, 1.0)
    assert np.isnan(measured.correlation.mean)
    assert "–" in sensitivity_table([measured]).lines[0][5]
    assert draw_sensitivity({"b": made(0.0, 0.0)}, [measured]).axes


@pytest.mark.parametrize("name", ["laptop", "evening", "full"])
def test_twins_are_driven_as_the_reproduction_drove(name: str) -> None:
    size = SIZES[name]
    drive = next(one for one in planned_drives(size, contrast=0.5) if one.part == "test")
    recorded = SimpleNamespace(name=drive.name, rows=SimpleNamespace(time=np.zeros(round(drive.settings.seconds / DT))))
    of = SimpleNamespace(size=size, contrast=0.5, dataset=SimpleNamespace(drives=[recorded]))
    assert replace(settings_of(of, drive.name, 1e9), seconds=drive.settings.seconds) == drive.settings
    assert settings_of(of, drive.name, 7.0).seconds == 7.0


def test_twins_are_extracted_with_the_rig_of_the_dataset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig, given = load_rig("proving_ground_gear"), []
    dataset = SimpleNamespace(rig=rig, drives=[])
    of = SimpleNamespace(size=SIZES["evening"], contrast=1.0, dataset=dataset, pca=tmp_path / "pca.safetensors")

    def extracted(*_args, rig, **_options):
        given.append(rig)
        raise InterruptedError

    monkeypatch.setattr(twins, "driven_dataset", extracted)
    with pytest.raises(InterruptedError):
        twins.twins_control(of, tmp_path, drives=2, seconds=7.0, oracle=None)
    assert given == [rig]


@pytest.fixture(scope="module")
def settings() -> DriveSettings:
    return DriveSettings(WorldSettings("mojave", 5, size=80.0, resolution=0.5), 7.0, 5, "none")


def test_twins_part_from_a_drive(settings: DriveSettings, tmp_path: Path) -> None:
    world, ground = twin_worlds(settings)
    np.testing.assert_array_equal(world.elevation, ground.elevation)
    assert np.abs(world.properties - ground.properties).mean() > 0.01
    at = np.array([1, 41, 81, 10_000])
    same, other = (branches_of(settings, world, g, at) for g in (world, ground))
    assert (same.difference() == 0).all()  # bit by bit: the same state, ground and commands
    np.testing.assert_array_equal(same.path, other.path)
    assert np.hypot(*other.difference().T).max() > 0.1
    assert same.step.tolist() == [1, 41, 81]
    save_branches(tmp_path / "b.safetensors", other)
    np.testing.assert_array_equal(load_branches(tmp_path / "b.safetensors").other, other.other)
