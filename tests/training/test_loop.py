"""The training loop: its best epoch and warnings, resuming, and memory that the process keeps."""

import ctypes
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
import torch

from offpiste.core.errors import RunError, TrainingError
from offpiste.dataset.windows import Windows
from offpiste.training import loop
from offpiste.training.checkpoint import save_tensors
from offpiste.training.config import TrainConfig
from offpiste.training.loop import BestEpoch


@pytest.mark.parametrize(
    ("epoch", "line", "warning"),
    [
        (7, "model: kept epoch 7 of 12, validation 0.6251", None),
        (12, "model: kept epoch 12 of 12, validation 0.6251", "the last epoch is the best"),
        (1, "model: kept epoch 1 of 12, validation 0.6251", "the first epoch is the best"),
        (0, "model: kept the initial weights, validation 0.6251: no epoch of 12 was better", None),
    ],
)
def test_an_epoch_in_words(epoch: int, line: str, warning: str | None) -> None:
    best = BestEpoch(epoch, 12, 0.62512)
    assert best.line("model") == line
    found = list(best.warnings("model"))
    assert len(found) == (warning is not None)
    assert warning is None or warning in found[0]


@pytest.mark.parametrize("losses", [[1.0, 0.5, 0.4999, 0.4998, 0.4997], [1.0, 0.9, 0.8, 0.7, 0.6], [1.0, 0.5]])
def test_a_stage_that_is_read_back_has_the_same_warnings(losses: list[float]) -> None:
    fresh = BestEpoch.last_of(len(losses), losses, len(losses), losses[-1])
    again = BestEpoch.of(json.loads(json.dumps(fresh.about())), len(losses))
    assert again == fresh
    assert list(again.warnings("bicycle")) == list(fresh.warnings("bicycle"))


@pytest.mark.parametrize(("stage", "option"), [("model", "--epochs"), ("bicycle", "--bicycle-epochs")])
def test_the_warning_names_the_option_with_the_epochs(stage: str, option: str) -> None:
    (warning,) = BestEpoch(12, 12, 0.5).warnings(stage)
    assert warning.endswith(f"with more than 12 {option}")


def test_actuators_and_stages_of_one_epoch_have_no_warnings() -> None:
    assert not list(BestEpoch(8, 8, 0.02).warnings("actuators"))
    assert not list(BestEpoch(1, 1, 0.5).warnings("model"))


def test_epochs_that_hardly_improve_have_converged() -> None:
    falling = BestEpoch.last_of(6, [1.0, 0.9, 0.8, 0.7, 0.6, 0.5], 6, 0.5)
    assert falling.gained == pytest.approx(1 - 0.5 / 0.8)
    assert list(falling.warnings("model"))
    still = BestEpoch.last_of(6, [1.0, 0.5002, 0.5002, 0.5001, 0.5001, 0.5], 6, 0.5)
    assert not list(still.warnings("model"))
    assert BestEpoch.last_of(2, [1.0, 0.5], 2, 0.5).gained is None


FAULTS = """
import resource, sys
import torch
from offpiste.training.loop import keep_freed_memory

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
def test_a_stage_that_resumes_has_the_warnings_of_one_that_was_not_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, epochs: int
) -> None:
    """It has converged: the last epochs improve by a hundredth of a percent."""
    monkeypatch.setattr(loop, "train_epoch", lambda *arguments: 1.0)
    losses = [0.4, 0.3, 0.2999, 0.29988, 0.29986, 0.29984]

    def kept(folder: Path, scores: Sequence[float]) -> BestEpoch:
        line, given, unread = torch.nn.Linear(1, 1), iter(scores), Windows.__new__(Windows)
        stage = loop.Stage("line", line, lambda batch: line.weight[0], len(losses), on_map=lambda: next(given))
        return loop.run_stage(stage, unread, unread, TrainConfig(), folder, lambda metrics: None)

    whole = kept(tmp_path / "whole", [1.0, *losses])
    with pytest.raises(StopIteration):
        kept(tmp_path / "stopped", [1.0, *losses[:epochs]])
    assert kept(tmp_path / "stopped", losses[epochs:]) == whole
    assert whole.has_converged


def test_a_finished_stage_of_another_version_ends_in_one_line(tmp_path: Path) -> None:
    line, unread = torch.nn.Linear(1, 1), Windows.__new__(Windows)
    save_tensors(tmp_path / "line.safetensors", line.state_dict(), validation_loss=1.0)
    stage = loop.Stage("line", line, lambda batch: line.weight[0], 1)
    with pytest.raises(RunError, match=r"another version of offpiste \(no 'kept_epoch'\); delete the file"):
        loop.run_stage(stage, unread, unread, TrainConfig(), tmp_path, lambda metrics: None)


def test_a_stage_without_a_finite_validation_loss_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop, "train_epoch", lambda *arguments: 1.0)
    line, unread = torch.nn.Linear(1, 1), Windows.__new__(Windows)
    stage = loop.Stage("line", line, lambda batch: line.weight[0], 2, on_map=lambda: float("inf"))
    with pytest.raises(TrainingError, match="line: no epoch has a finite validation loss"):
        loop.run_stage(stage, unread, unread, TrainConfig(), tmp_path, lambda metrics: None)
    assert not (tmp_path / "line.safetensors").exists()
