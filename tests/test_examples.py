"""Examples do what they say."""

import runpy
from pathlib import Path

import pytest
import torch

EXAMPLES = Path(__file__).parents[1] / "examples"


def test_pytorch_mppi_drives_with_our_model():
    pytest.importorskip("pytorch_mppi")
    example = runpy.run_path(str(EXAMPLES / "pytorch_mppi_with_offpiste.py"))
    states = example["drive"](steps=50)
    assert states.shape == (50, 6)
    assert states.isfinite().all()
    # Straight ahead it would be 0.4 m outside after 1 s.
    off = (torch.hypot(states[:, 0], states[:, 1]) - example["RADIUS"]).abs()
    assert off.max() < 0.3
    assert torch.equal(example["drive"](steps=6), states[:6])
