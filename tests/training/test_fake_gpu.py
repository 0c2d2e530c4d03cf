"""Training on a fake GPU: tensors are on the right device, and the loss equals that of the CPU."""

import pytest
import torch

from fake_gpu import GPU, fake_gpu
from feature_datasets import dataset_with_features, with_snapshots
from host_kernels import HostKernels, needs_gcc
from offpiste.training.config import TrainConfig
from offpiste.training.run import best_epochs
from offpiste.training.train import train


def test_tensors_of_two_devices_cannot_be_combined(monkeypatch):
    with fake_gpu(monkeypatch, HostKernels):
        there = torch.ones(3, device=GPU)
        assert there.device == GPU
        assert (there + 1).device == GPU
        assert (there.cpu() * 2).tolist() == [2, 2, 2]
        with pytest.raises(RuntimeError, match="on the CPU and on the GPU"):
            there + torch.ones(3)


@needs_gcc
@pytest.mark.parametrize(("model", "maps"), [("b", False), ("dc", True)])
def test_training_on_the_gpu_equals_training_on_the_cpu(model, maps, tmp_path, monkeypatch):
    dataset = dataset_with_features(tmp_path / "data.zarr", rows=400)
    if maps:
        dataset = with_snapshots(dataset, tmp_path / "snapshots", range(20, 400, 40))
    losses = []
    for device in ("cpu", str(GPU)):
        config = TrainConfig(model, epochs=1, bicycle_epochs=1, actuator_epochs=1, stride=25, batch=8, device=device)
        if device == "cpu":
            train(dataset, config, tmp_path / device[:3])
        else:
            with fake_gpu(monkeypatch, HostKernels):
                train(dataset, config, tmp_path / device[:3])
        losses.append(best_epochs(tmp_path / device[:3])["model"].validation_loss)
    assert losses[1] == pytest.approx(losses[0], rel=1e-3)
