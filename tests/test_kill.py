"""Work that is killed and done again leaves the same files as work that was not; `tests/kill.py` does more of it."""

from pathlib import Path

import kill


def test_a_killed_training_and_simulation_end_as_others_do(tmp_path: Path) -> None:
    (tmp_path / "inputs").mkdir()
    works = {"train": 2, "simulate": 1}
    kill.make_inputs(tmp_path / "inputs", works)
    for name, moments in works.items():
        assert kill.kill_often(name, tmp_path / "inputs", tmp_path / name, moments, seed=0) == []


def test_a_difference_is_found(tmp_path: Path) -> None:
    for name, seconds, loss in (("one", 1.0, 0.5), ("same", 2.0, 0.5), ("other", 1.0, 0.6)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "metrics.jsonl").write_text(f'{{"seconds": {seconds}, "loss": {loss}}}\n')
    one, same, other = (kill.contents(tmp_path / name) for name in ("one", "same", "other"))
    assert kill.differences(one, same) == []
    assert kill.differences(one, other) == ["metrics.jsonl"]
    (tmp_path / "same" / ".left.partial").write_text("")
    assert kill.differences(one, kill.contents(tmp_path / "same")) == [".left.partial"]
