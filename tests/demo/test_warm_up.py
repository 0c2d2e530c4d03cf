"""What `offpiste warm-up` compiles is what training calls, and its parts run."""

from pathlib import Path

import numpy as np
import pytest
import torch

from feature_datasets import dataset_with_features
from offpiste.core.errors import RunError
from offpiste.dataset.windows import Windows
from offpiste.demo.first_minute import shipped
from offpiste.demo.warm_up import PLAN, RECORD, compile_training, rehearse, rehearse_part
from offpiste.dynamics.kernels import actuators, encoder, rollout
from offpiste.native.compilation import KERNELS
from offpiste.training.prediction import predict_batch
from offpiste.training.run import build, vehicle_of

ENTRIES = (
    rollout.forward, rollout.backward, encoder.encode_forward, encoder.encode_backward, encoder.add_by_cell,
    actuators.lag_forward, actuators.lag_backward,
)  # fmt: skip


def test_training_compiles_nothing_more(tmp_path) -> None:
    assert KERNELS.part
    compile_training()
    compiled = [set(entry.signatures) for entry in ENTRIES]
    assert all(compiled)
    dataset = dataset_with_features(tmp_path / "data.zarr")
    model, windows = build("dc", vehicle_of(dataset), seed=0), Windows(dataset, "train")
    model.actuators.requires_grad_(False)
    predict_batch(model, windows.gather(np.arange(3))).state.sum().backward()
    with torch.no_grad():
        predict_batch(model, windows.gather(np.arange(3)))
    assert [set(entry.signatures) for entry in ENTRIES] == compiled


@pytest.mark.parametrize("part", [RECORD, PLAN])
def test_each_part_is_done(part: str, tmp_path: Path) -> None:
    assert rehearse_part(part, lambda share: None, run=shipped("dc"), folder=tmp_path) == part
    assert (tmp_path / "drive.mcap").exists() == (part == RECORD)


def test_what_goes_wrong_is_said() -> None:
    with pytest.raises(RunError, match="no pretrained model 'proving-ground/none'"):
        rehearse(shipped("none"), 1)
