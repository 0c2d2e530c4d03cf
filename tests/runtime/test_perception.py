"""Encoding of images on a GPU."""

import numpy as np
import pytest
import torch

from fake_gpu import GPU, Faking, FromNumbers
from offpiste.runtime.perception import codes_of, encoder_on
from offpiste.runtime.planner import load_planner

RUN = "pretrained:proving-ground/dc"


@pytest.mark.parametrize("novelty", ["ignored", "missing"])
def test_codes_computed_on_a_gpu_equal_those_of_the_cpu(novelty):
    pixels = np.random.default_rng(0).integers(0, 256, (140, 280, 3), dtype=np.uint8)
    planner = load_planner(RUN, novelty=novelty)
    wanted = codes_of(pixels, planner.extractor.extract, planner.dynamics.encoder)
    with FromNumbers(), Faking():
        there = load_planner(RUN, novelty=novelty, device=str(GPU))
        encoder = encoder_on(str(GPU), there.dynamics.encoder)
        found = codes_of(pixels, there.extractor.extract, encoder)
        assert {part.device for part in encoder.state_dict().values()} == {GPU}
    assert {part.device for part in there.dynamics.state_dict().values()} == {torch.device("cpu")}
    np.testing.assert_allclose(found, wanted, atol=1e-4)
    assert (np.std(wanted, axis=(0, 1)) > 0.01).all() == (novelty == "ignored")  # noise looks like no ground
