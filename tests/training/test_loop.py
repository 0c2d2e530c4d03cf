"""The training loop: its best epoch and warnings, and resuming."""

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
def test_the_best_epoch_has_a_line_and_warnings(epoch: int, line: str, warning: str | None) -> None:
    best = BestEpoch(epoch, 12, 0.62512)
    assert best.line("model") == line
    found = list(best.warnings("model"))
    assert len(found) == (warning is not None)
    assert warning is None or warning in found[0]
    assert epoch != 12 or found[0].endswith("with more than 12 --epochs")
    assert not list(best.warnings("actuators"))


def test_stages_whose_last_epochs_hardly_improve_have_converged() -> None:
    falling = BestEpoch.last_of(6, [1.0, 0.9, 0.8, 0.7, 0.6, 0.5], 6, 0.5)
    assert falling.gained == pytest.approx(1 - 0.5 / 0.8)
    assert list(falling.warnings("model"))
    still = BestEpoch.last_of(6, [1.0, 0.5002, 0.5002, 0.5001, 0.5001, 0.5], 6, 0.5)
    assert not list(still.warnings("model"))
    assert BestEpoch.last_of(2, [1.0, 0.5], 2, 0.5).gained is None


@pytest.mark.parametrize("epochs", [1, 4])
def test_a_resumed_stage_has_the_warnings_of_an_uninterrupted_one(
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
    assert kept(tmp_path / "stopped", []) == whole, "read back"
    assert whole.has_converged


def test_stages_of_another_version_or_without_a_finite_validation_loss_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "train_epoch", lambda *arguments: 1.0)
    line, unread = torch.nn.Linear(1, 1), Windows.__new__(Windows)
    stage = loop.Stage("line", line, lambda batch: line.weight[0], 2, on_map=lambda: float("inf"))
    with pytest.raises(TrainingError, match="line: no epoch has a finite validation loss"):
        loop.run_stage(stage, unread, unread, TrainConfig(), tmp_path, lambda metrics: None)
    assert not (tmp_path / "line.safetensors").exists()
    save_tensors(tmp_path / "line.safetensors", line.state_dict(), validation_loss=1.0, kept_epoch=1)
    with pytest.raises(RunError, match="another version of offpiste; delete the file"):
        loop.run_stage(stage, unread, unread, TrainConfig(), tmp_path, lambda metrics: None)
