"""A loss of an extension, through the command line."""

import json
from pathlib import Path

from extending.outside import succeeded
from factories import circle_dataset, circle_rows

VALUES = """
import torch
from offpiste.training.losses import LOSSES

squared = torch.zeros(2, 4, 5)
squared[0, 0, 0] = squared[1, 3, 0] = 1.0
print(LOSSES["late"](squared, torch.ones(5)).tolist())
"""


def test_late_errors_cost_more():
    early, late = json.loads(succeeded("-c", VALUES, extension="late_loss"))
    assert (round(early, 6), round(late, 6)) == (0.1, 0.4)


def test_a_model_is_trained_with_the_loss_of_an_extension(tmp_path: Path) -> None:
    path = circle_dataset(tmp_path / "circles.zarr", circle_rows(3000)).path
    few = ("--model", "parametric", "--epochs", "1", "--actuator-epochs", "1", "--stride", "100", "--batch", "32")
    succeeded("train", path, "--out", tmp_path / "run", "--loss", "late", *few, extension="late_loss")
    assert json.loads((tmp_path / "run" / "model.json").read_text("utf-8"))["train"]["loss"] == "late"
