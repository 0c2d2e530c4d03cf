"""Killed and repeated work leaves the same files as work that was not killed: `KILLS=20 pytest tests/test_kill.py`."""

import os
import time
from pathlib import Path

import numpy as np
import pytest

import kill

KILLS = {name: int(os.environ.get("KILLS", usual)) for name, usual in zip(kill.WORK, (1, 0, 2, 0), strict=True)}
"""Number of random moments at which each job is killed."""


@pytest.mark.parametrize("name", [name for name, kills in KILLS.items() if kills])
def test_a_killed_job_ends_as_others_do(name: str, tmp_path: Path) -> None:
    (inputs := tmp_path / "inputs").mkdir()
    kill.make_inputs(inputs, (name,))
    kill.finish(kill.start(name, inputs, tmp_path / "first"))  # compiles kernels
    process, began = kill.start(name, inputs, tmp_path / "whole"), time.perf_counter()
    kill.finish(process)
    seconds, whole = time.perf_counter() - began, kill.contents(tmp_path / "whole")
    assert kill.differences(whole, kill.contents(tmp_path / "first")) == [], "done twice"
    for number, share in enumerate(np.random.default_rng(0).random(KILLS[name])):
        kill.kill_at(name, inputs, tmp_path / f"killed-{number}", share * seconds)
        different = kill.differences(whole, kill.contents(tmp_path / f"killed-{number}"))
        assert different == [], f"killed after {share * seconds:.2f} s"


def test_a_difference_is_found(tmp_path: Path) -> None:
    for name, seconds, loss in (("one", 1.0, 0.5), ("same", 2.0, 0.5), ("other", 1.0, 0.6)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "metrics.jsonl").write_text(f'{{"seconds": {seconds}, "loss": {loss}}}\n')
    one, same, other = (kill.contents(tmp_path / name) for name in ("one", "same", "other"))
    assert kill.differences(one, same) == []
    assert kill.differences(one, other) == ["metrics.jsonl"]
    (tmp_path / "same" / ".left.partial").write_text("")
    assert kill.differences(one, kill.contents(tmp_path / "same")) == [".left.partial"]
