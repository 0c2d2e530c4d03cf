"""The device of a training."""

from types import SimpleNamespace

import torch

from offpiste.training.run import check_device


def test_lstms_on_a_gpu_compute_in_float32(monkeypatch):
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", True)
    assert check_device("cpu") == torch.device("cpu")
    assert torch.backends.cudnn.allow_tf32
    gpu = torch.device("cuda", 1)
    monkeypatch.setattr(torch, "zeros", lambda *size, device: SimpleNamespace(device=gpu, item=lambda: 0.0))
    assert check_device("cuda") == gpu
    assert not torch.backends.cudnn.allow_tf32
