"""Training by several processes, which share all windows and arrive at the weights of a single process."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from cli.command import run
from factories import circle_rows, stored_dataset
from offpiste.core.errors import RunError
from offpiste.training.distributed import ALONE, Group, joined

TORCHRUN = [sys.executable, "-m", "torch.distributed.run"]
SETTINGS = ["--epochs", "2", "--bicycle-epochs", "2", "--actuator-epochs", "1", "--batch", "33"]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    drives = {"one": circle_rows(2400)}
    return stored_dataset(tmp_path_factory.mktemp("ddp") / "data.zarr", drives, "blocks:0.5,0.25,0.25").path


def test_processes_share_all_windows_and_ddp_needs_torchrun(monkeypatch):
    for count in (0, 1, 2, 7, 128):
        for size in (1, 2, 3):
            shares = [np.arange(count)[Group(rank, size).share(count)] for rank in range(size)]
            np.testing.assert_array_equal(np.concatenate(shares), np.arange(count))
    value = torch.tensor(3.0, requires_grad=True)
    assert ALONE.sum(value) is value
    ALONE.sum_gradients([value])
    assert value.grad is None
    with pytest.raises(RunError, match="here"):
        ALONE.together(RunError("here"))
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    with pytest.raises(RunError, match="torchrun"), joined("cpu"):
        raise AssertionError


def test_two_processes_train_what_one_does(dataset, tmp_path):
    assert run("train", dataset, "--out", tmp_path / "one", *SETTINGS) == 0
    train = ["-m", "offpiste", "train", str(dataset), "--out", str(tmp_path / "two"), *SETTINGS, "--ddp"]
    command = [*TORCHRUN, "--nproc-per-node", "2", *train]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("model: kept ") == 1
    ours, theirs = (
        [json.loads(line) for line in (tmp_path / name / "metrics.jsonl").read_text().splitlines()]
        for name in ("one", "two")
    )
    assert len(ours) == len(theirs) == 4
    for one, two in zip(ours, theirs, strict=True):
        assert (one["stage"], one["epoch"]) == (two["stage"], two["epoch"])
        assert two["train_loss"] == pytest.approx(one["train_loss"], rel=1e-4)
        assert two["validation_loss"] == pytest.approx(one["validation_loss"], rel=1e-4)
    weights = load_file(tmp_path / "one" / "model.safetensors")
    for name, value in load_file(tmp_path / "two" / "model.safetensors").items():
        torch.testing.assert_close(value, weights[name], rtol=2e-3, atol=2e-4)
    again = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert again.returncode
    assert "holds a run already" in again.stderr


def test_a_process_that_dies_on_another_node_is_reported_and_resuming_continues(dataset, tmp_path):
    """Two nodes of `torchrun`, here on one machine."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])

    def start(out: str, *more: str) -> list["subprocess.Popen[str]"]:
        nodes = [[*TORCHRUN, "--nnodes", "2", "--nproc-per-node", "1", "--node-rank", str(rank)] for rank in range(2)]
        command = ["--master-addr", "127.0.0.1", "--master-port", port, "-m", "offpiste", "train", str(dataset)]
        command += ["--out", str(tmp_path / out), *SETTINGS, "--epochs", "20", "--ddp", *more]
        return [subprocess.Popen([*node, *command], stderr=subprocess.PIPE, text=True) for node in nodes]

    assert [process.wait(200) for process in start("whole")] == [0, 0]
    killed, metrics = start("killed"), tmp_path / "killed" / "metrics.jsonl"
    while killed[0].poll() is None and not (metrics.exists() and metrics.read_text().count("\n") > 5):
        time.sleep(0.05)
    (worker,) = Path(f"/proc/{killed[1].pid}/task/{killed[1].pid}/children").read_text().split()
    os.kill(int(worker), signal.SIGKILL)
    said = killed[0].communicate(timeout=100)[1]
    assert all(process.wait(100) for process in killed)
    assert said.count("another process of this training was lost") == 1
    assert "[rank0]" not in said, "a traceback"
    assert [process.wait(200) for process in start("killed", "--resume")] == [0, 0]
    ours, theirs = (load_file(tmp_path / name / "model.safetensors") for name in ("whole", "killed"))
    assert all(torch.equal(value, theirs[name]) for name, value in ours.items())
