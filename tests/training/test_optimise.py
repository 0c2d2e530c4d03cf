"""A training asks the system for memory once, not at every step; a stage that resumes comes to the same end."""

import ctypes
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
import torch

from offpiste.dataset.windows import Windows
from offpiste.training import optimise
from offpiste.training.config import TrainConfig
from offpiste.training.kept_epoch import KeptEpoch

FAULTS = """
import resource, sys
import torch
from offpiste.training.optimise import keep_freed_memory

if sys.argv[1] == "kept":
    keep_freed_memory()
for _ in range(3):
    torch.zeros(16 << 20).fill_(1)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(5):
    torch.zeros(16 << 20).fill_(1)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def page_faults(memory: str) -> int:
    """Of five blocks of 64 MiB, one after the other, in a process of its own."""
    command = [sys.executable, "-c", FAULTS, memory]
    return int(subprocess.run(command, capture_output=True, check=True, text=True).stdout)


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="the allocator is not glibc's")
def test_pages_of_freed_blocks_are_cleared_once() -> None:
    assert page_faults("kept") < page_faults("usual") / 4


@pytest.mark.parametrize("epochs", [1, 3, 5])
def test_a_stage_that_resumes_is_doubted_as_one_that_was_not_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, epochs: int
) -> None:
    """It had converged: the last epochs took off a hundredth of a percent."""
    monkeypatch.setattr(optimise, "_train_epoch", lambda *arguments: 1.0)
    losses = [0.4, 0.3, 0.2999, 0.29988, 0.29986, 0.29984]

    def kept(folder: Path, scores: Sequence[float]) -> KeptEpoch:
        line, given, unread = torch.nn.Linear(1, 1), iter(scores), Windows.__new__(Windows)
        stage = optimise.Stage("line", line, lambda batch: line.weight[0], len(losses), on_map=lambda: next(given))
        return optimise.run_stage(stage, unread, unread, TrainConfig(), folder, lambda metrics: None)

    whole = kept(tmp_path / "whole", [1.0, *losses])
    with pytest.raises(StopIteration):
        kept(tmp_path / "stopped", [1.0, *losses[:epochs]])
    assert kept(tmp_path / "stopped", losses[epochs:]) == whole
    assert whole.has_converged
