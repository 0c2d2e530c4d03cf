"""Drives from settings to files: ends, repeatability, interruptions, several at once."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from cli.command import refusal, run
from offpiste.core.errors import OffpisteError
from offpiste.logs import read_drive
from offpiste.rig.rig import load_rig
from offpiste.simulation import simulate as simulation
from offpiste.simulation.simulate import DriveSettings, Recording, Start, drive, simulate, simulate_all
from offpiste.simulation.top_view import draw_top_view, shaded_colours
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


STICKY = flat_world(properties=(1.6, 12.0, 0.02, 0.0))


@pytest.mark.parametrize(
    ("world", "x", "speed", "driver", "event", "least", "most"),
    [
        # Full lock at 12 m/s on ground that holds: the outer wheels trip it.
        (STICKY, 0.0, 12.0, Always((1.0, 0.0, 1.0)), "rollover", 10, 400),
        (flat_world(), 110.0, 8.0, Always((0.5, 0.0, 0.0)), "left the world", 10, 400),
        (flat_world(), 0.0, 0.0, Always((0.0, 1.0, 0.0), 30), "stuck", 30, 30),
    ],
)
def test_an_event_is_told_once_and_ends_the_drive(world, x, speed, driver, event, least, most):
    samples = list(drive(world, VEHICLE, Start(x, 0.0, 0.0, speed), driver, steps=500))
    assert [sample.events for sample in samples if sample.events] == [(event,)]
    assert least <= len(samples) <= most
    assert samples[-1].events
    assert event != "left the world" or samples[-1].position[0] == pytest.approx(120 - 3, abs=0.3)


RIG = load_rig("proving_ground")
WORLD = WorldSettings("mojave", seed=1, size=100.0, resolution=0.5)
SETTINGS = DriveSettings(WORLD, seconds=6.0, seed=3, sensors="none")


def test_the_same_settings_give_the_same_bytes_and_another_seed_others(tmp_path):
    driven, again = (simulate(SETTINGS, tmp_path / name) for name in ("drive.mcap", "again.mcap"))
    assert again.log.read_bytes() == driven.log.read_bytes()
    other = simulate(replace(SETTINGS, seed=4), tmp_path / "other.mcap")
    assert other.log.read_bytes() != driven.log.read_bytes()


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
    ("arguments", "said"),
    [
        (("--world", "moon"), "moon"),
        (("--seconds", "0"), "invalid duration 0 s"),
        (("--seconds", "nan"), "invalid duration nan s"),
        (("--pose-noise", "-1"), "invalid pose_noise_m = -1"),
        (("--mounting-turn", "nan"), "invalid mounting_turn = nan; give a number of 0 or more"),
        (("--stamp-offset", "inf"), "invalid stamp_offset_ms = inf"),
        (("--drive-seed", "-1"), "invalid drive seed -1"),
        (("--out", "{tmp}/there.mcap"), "exists already"),
        (("--drives", "0"), "0 drives"),
        (("--drives", "2", "--drive-seed", "1"), "--drive-seed cannot be combined with --drives"),
        (("--drives", "2", "--processes", "-1"), "invalid --processes -1; give 1 or more, or 0"),
    ],
)
def test_a_mistake_ends_in_one_line_and_exit_code_1(arguments, said, tmp_path, capsys):
    (tmp_path / "there.mcap").write_bytes(b"")
    given = [argument.format(tmp=tmp_path) for argument in arguments]
    out = [] if "--out" in given else ["--out", str(tmp_path / "drive.mcap")]
    assert said in refusal(capsys, "simulate", "--sensors", "none", *given, *out)
    assert [file.name for file in tmp_path.iterdir()] == ["there.mcap"]


def test_a_log_with_manoeuvres_reverses_and_is_found_healthy(tmp_path, capsys):
    log = str(tmp_path / "drive.mcap")
    # The driver of this seed reverses within the time.
    assert run("simulate", "--manoeuvres", "--sensors", "none", "--seed", "2", "--world", "dunes", "--out", log) == 0
    assert "--rig proving_ground_gear" in capsys.readouterr().out
    gear = read_drive(log, load_rig("proving_ground_gear")).channels["gear"].values
    assert (gear == -1).mean() > 0.02
    assert run("inspect", log, "--rig", "proving_ground_gear") == 0
    assert "nothing to fix" in capsys.readouterr().out


def recordings(folder: Path) -> list[Recording]:
    folder.mkdir()
    return [Recording(replace(SETTINGS, seconds=3.0, seed=seed), folder / f"{seed}.mcap") for seed in range(3)]


def test_processes_record_what_one_does_also_beside_failed_and_existing_drives(tmp_path: Path) -> None:
    alone, shared = recordings(tmp_path / "alone"), recordings(tmp_path / "shared")
    simulate_all(alone, 1)
    shared[0].log.write_bytes(b"there")
    shared[1].log.with_name("1.partial.mcap").write_bytes(b"left by a process that was killed")
    bad = Recording(replace(SETTINGS, world=WorldSettings("nowhere")), tmp_path / "shared" / "bad.mcap")
    with pytest.raises(OffpisteError, match="nowhere"):
        simulate_all([bad, *shared], 2)
    assert shared[0].log.read_bytes() == b"there"
    assert [one.log.read_bytes() for one in shared[1:]] == [one.log.read_bytes() for one in alone[1:]]
    assert sorted(path.name for path in (tmp_path / "shared").iterdir()) == ["0.mcap", "1.mcap", "2.mcap"]


def test_a_world_is_drawn():
    world = make_world(WorldSettings(preset="halter-ranch", size=80.0, resolution=1.0))
    assert shaded_colours(world).std(axis=(0, 1)).min() > 0.02
    figure = Figure()
    draw_top_view(world, figure.subplots())
    figure.savefig(BytesIO(), format="png", dpi=40)
    assert figure.axes[0].get_xlim() == (-40, 40)
