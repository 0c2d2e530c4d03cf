"""Work that is killed and done again leaves the same files as work that was not; `tests/kill.py` does more of it."""

from pathlib import Path

import kill


def test_a_killed_training_and_simulation_end_as_others_do(tmp_path: Path) -> None:
    (tmp_path / "inputs").mkdir()
    works = {"train": 2, "simulate": 1}
    kill.make_inputs(tmp_path / "inputs", works)
    for name, moments in works.items():
        assert kill.kill_often(name, tmp_path / "inputs", tmp_path / name, moments, seed=0) == []
