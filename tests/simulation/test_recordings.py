"""Several drives recorded side by side: the same bytes in any number of processes, and only those that are missing."""

from pathlib import Path

import pytest

from log_messages import logged
from offpiste.cli import main
from offpiste.core.errors import OffpisteError
from offpiste.core.parallel import Outcome
from offpiste.simulation.simulate import DriveSettings, Recording, simulate_all
from offpiste.simulation.world.world import WorldSettings

WORLD = WorldSettings("uniform", size=150.0, resolution=0.5)


def recordings(folder: Path) -> list[Recording]:
    folder.mkdir()
    return [Recording(DriveSettings(WORLD, 3.0, seed, "none"), folder / f"{seed}.mcap") for seed in range(3)]


def test_processes_record_what_one_does_and_what_is_there_stays(tmp_path: Path) -> None:
    alone, shared = recordings(tmp_path / "alone"), recordings(tmp_path / "shared")
    simulate_all(alone, 1)
    shared[0].log.write_bytes(b"there")
    shared[1].log.with_name("1.partial.mcap").write_bytes(b"left by a process that was killed")
    simulate_all(shared, 2)
    assert shared[0].log.read_bytes() == b"there"
    assert [one.log.read_bytes() for one in shared[1:]] == [one.log.read_bytes() for one in alone[1:]]
    assert sorted(path.name for path in (tmp_path / "shared").iterdir()) == ["0.mcap", "1.mcap", "2.mcap"]


def test_only_as_many_processes_record_as_memory_has_room_for(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("offpiste.core.machine.free_memory", lambda: int(2e9))
    started = []
    monkeypatch.setattr(
        "offpiste.simulation.simulate.run_all", lambda *given, **_: started.append(given[2]) or Outcome([], [])
    )
    with logged() as messages:
        simulate_all(recordings(tmp_path / "logs"), 16)
    assert started == [2]
    assert messages == ["2 of 3 processes at a time: 2.0 GB of memory are free, and each takes 0.7 GB"]


def test_one_that_fails_does_not_keep_the_others(tmp_path: Path) -> None:
    good = recordings(tmp_path / "logs")
    bad = Recording(DriveSettings(WorldSettings("nowhere"), 3.0, 0, "none"), tmp_path / "logs" / "bad.mcap")
    with pytest.raises(OffpisteError, match="nowhere"):
        simulate_all([bad, *good], 1)
    assert sorted(path.name for path in (tmp_path / "logs").iterdir()) == ["0.mcap", "1.mcap", "2.mcap"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--drives", "0"], "0 drives"),
        (["--drives", "2", "--drive-seed", "1"], "--drive-seed cannot be combined with --drives"),
        (["--drives", "2", "--processes", "-1"], "--processes is -1; give 1 or more, or 0"),
    ],
)
def test_what_does_not_go_together(words: list[str], said: str, tmp_path: Path, capsys) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(["simulate", "--out", str(tmp_path / "logs"), *words])
    assert exit_.value.code == 1
    assert said in capsys.readouterr().err
    assert not (tmp_path / "logs").exists()
