"""A network of an extension that kernels do not support."""

import numpy as np

from extending.outside import extracted_car, offpiste, succeeded
from offpiste.core.conventions import DT

PREDICT = """
import sys
import torch
from offpiste.dataset.store import open_dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import rollout
from offpiste.core.state import RecordedTerrain
from offpiste.training.prediction import predict_batch
from offpiste.training.run import load_run

run = load_run(sys.argv[2])
windows = Windows(open_dataset(sys.argv[1]), "train")
batch = windows.gather(windows.every(100))
with torch.no_grad():
    start = run.dynamics.start(batch.history, batch.state, batch.actuators)
    eager = rollout(run.dynamics, start, batch.control, RecordedTerrain(batch.terrain)).state
    assert torch.equal(predict_batch(run.dynamics, batch).state, eager)
assert type(run.dynamics.compensator.cell).__name__ == "GRU"
assert start.recurrent.shape[1] == run.dynamics.recurrent_size == 4 + run.dynamics.actuators.recurrent_size
"""


def test_a_hybrid_model_with_a_gru_trains_with_a_warning_and_predicts_its_own_steps(tmp_path):
    time = DT * np.arange(3000)
    throttle = 0.5 + 0.5 * np.sin(time)
    dataset = extracted_car(tmp_path, "", extension="gated", split="blocks:0.6,0.2,0.2", throttle=throttle)
    words = ("--model", "b-gru", "--out", tmp_path / "run", "--epochs", "1", "--stride", "50")
    trained = offpiste("train", dataset, *words, extension="gated")
    assert trained.returncode == 0, trained.stderr
    said = " ".join((trained.stderr + trained.stdout).split())
    assert said.count("its LSTM is a GRU): it is stepped eagerly") == 1
    succeeded("-c", PREDICT, dataset, tmp_path / "run", extension="gated")
    exported = offpiste("export", tmp_path / "run", "--out", tmp_path / "out", extension="gated")
    assert exported.returncode == 1
    assert "its LSTM is a GRU" in exported.stderr
