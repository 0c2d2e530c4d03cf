"""How drives begin and end; files with the same bytes again, readable after an interruption."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from offpiste.cli import main
from offpiste.core.errors import OffpisteError
from offpiste.inspection.extract import extract
from offpiste.logs import read_drive
from offpiste.logs.ground_truth import read_truth
from offpiste.rig.rig import load_rig
from offpiste.simulation import simulate as simulation
from offpiste.simulation.recorder import Imperfections
from offpiste.simulation.sensors.suite import SensorSuite, light_suite
from offpiste.simulation.simulate import DriveSettings, DriveSummary, Start, drive, record, simulate
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import WorldSettings
from simulation.drives import flat_world

VEHICLE = load_vehicle()


@dataclass
class Always:
    """One command, and giving up after some samples."""

    wanted: tuple[float, float, float]
    timeouts: int = 10**6

    @property
    def stuck(self):
        return self.timeouts <= 0

    def command(self, sample):
        self.timeouts -= 1
        return np.array(self.wanted)


def small(seed):
    return make_world(WorldSettings("mojave", seed=seed, size=100.0, resolution=0.5))


def test_another_suite_instead_of_the_settings(tmp_path):
    (lidar,) = light_suite().lidars
    suite = SensorSuite((), (replace(lidar, name="lidar_mast", rings=4, columns=16),))
    settings = DriveSettings(WorldSettings("mojave", seed=1, size=100.0, resolution=0.5))
    start, file = Start(0.0, 0.0, 0.0, 2.0), tmp_path / "drive.mcap"
    record(settings, small(1), VEHICLE, start, Always((0.2, 0, 0)), file, steps=20, suite=suite)
    with file.open("rb") as stream:
        topics = {channel.topic for channel in make_reader(stream).get_summary().channels.values()}
    assert "/lidar_mast/points" in topics
    assert not [topic for topic in topics if "camera" in topic or "lidar_top" in topic]


def test_a_rollover_ends_the_drive():
    # Full lock at 12 m/s on ground that holds: the outer wheels trip it.
    sticky = flat_world(properties=(1.6, 12.0, 0.02, 0.0))
    samples = list(drive(sticky, VEHICLE, Start(0.0, 0.0, 0.0, 12.0), Always((1.0, 0.0, 1.0)), steps=500))
    assert samples[-1].events == ("rollover",)
    assert 10 < len(samples) < 400


def test_the_border_ends_the_drive():
    samples = list(drive(flat_world(), VEHICLE, Start(110.0, 0.0, 0.0, 8.0), Always((0.5, 0.0, 0.0)), steps=500))
    assert samples[-1].events == ("left the world",)
    assert samples[-1].position[0] == pytest.approx(120 - 3, abs=0.3)


def test_giving_up_is_told_once_and_ends_the_drive():
    samples = list(drive(flat_world(), VEHICLE, Start(0.0, 0.0, 0.0, 0.0), Always((0.0, 1.0, 0.0), 30), steps=500))
    assert len(samples) == 30
    assert [s.events for s in samples if s.events] == [("stuck",)]


RIG = load_rig("proving_ground")
WORLD = WorldSettings("mojave", seed=1, size=100.0, resolution=0.5)
SETTINGS = DriveSettings(WORLD, seconds=6.0, seed=3, sensors="none")


def messages(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Stamps and bytes by topic."""
    found: dict[str, list[tuple[int, bytes]]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time, message.data))
    return found


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> DriveSummary:
    return simulate(SETTINGS, tmp_path_factory.mktemp("simulate") / "drive.mcap")


def test_the_same_settings_give_the_same_bytes_and_another_seed_others(driven, tmp_path):
    again = simulate(SETTINGS, tmp_path / "again.mcap")
    assert messages(again.log) == messages(driven.log)
    assert again.log.read_bytes() == driven.log.read_bytes()
    other = simulate(replace(SETTINGS, seed=4), tmp_path / "other.mcap")
    mine, others = messages(driven.log), messages(other.log)
    assert mine["/tf_static"] == others["/tf_static"]
    assert mine["/odometry"] != others["/odometry"]
    assert mine["/truth/map"] == others["/truth/map"]


def test_what_is_told_is_what_was_driven(driven):
    first, drive = driven, read_drive(driven.log, RIG)
    assert first.seconds == pytest.approx(6.0)
    assert first.path.shape == (300, 2)
    assert first.speed.shape == (300,)
    recorded = drive.channels["position"].values[:, :2]
    assert np.abs(recorded - first.path).max() < 0.05  # noise of the pose
    assert first.metres == pytest.approx(first.speed.sum() * 0.02, rel=0.05)
    assert str(first).startswith(f"{first.log}: 6 s, ")


def test_ground_truth_features_are_the_world_under_the_wheels(driven, tmp_path):
    dataset = extract([driven.log], RIG, tmp_path / "truth.zarr", split="blocks:1,0,0", features="ground-truth")
    cells, world = dataset.drives[0].rows.cells, make_world(WORLD)
    truth = read_truth(driven.log)
    rows = dataset.drives[0].rows.time
    # The truth's own record of each wheel's contact, next to the row.
    at = np.clip(np.searchsorted(truth.time, rows), 0, len(truth.time) - 1)
    contact = truth.contact[at][..., :2]
    i, j = np.moveaxis(np.round((contact - np.array(world.origin)) / world.resolution).astype(int), -1, 0)
    wanted = world.properties[j, i].astype(np.float16)
    found = cells.features[0, cells.index]
    assert (cells.index >= 0).all()
    same = (found == wanted).all(axis=-1)
    # Wheels are placed as of a level vehicle with a noisy pose: now and then that is the cell next to it.
    assert same.mean() > 0.75
    assert np.abs(found.astype(float) - truth.properties[at]).mean(axis=(0, 1))[0] < 0.03


def test_ctrl_c_leaves_a_readable_file(tmp_path, monkeypatch):
    def interrupted(steps: Iterable[int], _: str) -> Iterator[int]:
        yield from islice(steps, 130)
        raise KeyboardInterrupt

    monkeypatch.setattr(simulation, "track", interrupted)
    with pytest.raises(KeyboardInterrupt):
        simulate(SETTINGS, tmp_path / "cut.mcap")
    drive = read_drive(tmp_path / "cut.mcap", RIG)
    assert len(drive.channels["position"].time) == 130


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (replace(SETTINGS, seconds=0.0), "a drive of 0 s"),
        (replace(SETTINGS, seconds=float("nan")), "a drive of nan s"),
        (replace(SETTINGS, seconds=float("inf")), "a drive of inf s"),
        (replace(SETTINGS, seed=-1), "seed is -1"),
        (replace(SETTINGS, mounting_turn=float("nan")), "mounting_turn is nan; give a number of 0 or more"),
        (replace(SETTINGS, imperfections=Imperfections(pose_noise_m=-1.0)), "pose_noise_m is -1"),
        (replace(SETTINGS, imperfections=Imperfections(stamp_offset_ms=float("inf"))), "stamp_offset_ms is inf"),
        (replace(SETTINGS, sensors="sonar"), "sonar"),
        (replace(SETTINGS, world=replace(WORLD, preset="moon")), "moon"),
        (replace(SETTINGS, world=replace(WORLD, size=10.0)), "size is 10"),
    ],
)
def test_bad_settings_leave_no_file(settings, said, tmp_path):
    with pytest.raises(OffpisteError, match=said) as error:
        simulate(settings, tmp_path / "drive.mcap")
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_an_existing_file_is_refused_before_anything_is_written(tmp_path):
    (tmp_path / "drive.mcap").write_bytes(b"mine")
    with pytest.raises(OffpisteError, match=r"drive\.mcap: exists already"):
        simulate(SETTINGS, tmp_path / "drive.mcap")
    assert (tmp_path / "drive.mcap").read_bytes() == b"mine"


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as exit_:
        main(list(arguments))
    return int(exit_.value.code or 0)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--world", "moon"), "moon"),
        (("--seconds", "0"), "a drive of 0 s"),
        (("--drive-seed", "-1"), "seed is -1"),
        (("--grip-contrast", "2"), "grip_contrast is 2"),
        (("--out", "{tmp}/there.mcap"), "exists already"),
    ],
)
def test_a_mistake_ends_in_one_line_and_exit_code_1(arguments, said, tmp_path, capsys):
    (tmp_path / "there.mcap").write_bytes(b"")
    given = [argument.format(tmp=tmp_path) for argument in arguments]
    out = [] if "--out" in given else ["--out", str(tmp_path / "drive.mcap")]
    assert run("simulate", "--sensors", "none", *given, *out) == 1
    error = capsys.readouterr().err
    assert said in error
    assert error.startswith("offpiste: ")
    assert error.count("\n") == 1
    assert [file.name for file in tmp_path.iterdir()] == ["there.mcap"]


def test_the_command_line_records_what_can_be_extracted(tmp_path, capsys):
    log, dataset = str(tmp_path / "drive.mcap"), str(tmp_path / "data.zarr")
    assert run("simulate", "--sensors", "none", "--seconds", "5", "--out", log) == 0
    assert "drive.mcap: 5 s, " in capsys.readouterr().out
    assert run("extract", log, "--rig", "proving_ground", "--out", dataset, "--force") == 0
    drive = read_drive(log, RIG)
    assert len(drive.channels["position"].time) == 250


def test_a_log_with_manoeuvres_reverses_and_is_found_healthy(tmp_path, capsys):
    log, dataset = str(tmp_path / "drive.mcap"), str(tmp_path / "data.zarr")
    # The driver of this seed reverses within the time.
    assert run("simulate", "--manoeuvres", "--sensors", "none", "--seed", "2", "--world", "dunes", "--out", log) == 0
    assert "--rig proving_ground_gear" in capsys.readouterr().out
    gear = read_drive(log, load_rig("proving_ground_gear")).channels["gear"].values
    assert (gear == -1).mean() > 0.02
    assert run("inspect", log, "--rig", "proving_ground_gear") == 0
    assert "nothing to fix" in capsys.readouterr().out
    assert run("extract", log, "--rig", "proving_ground_gear", "--out", dataset, "--force") == 0
