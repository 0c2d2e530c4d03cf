"""Batches of an epoch are the same whether gathered ahead or not."""

import threading

import numpy as np
import pytest
import torch

from feature_datasets import dataset_with_features
from offpiste.dataset.feature_sets import per_trajectory
from offpiste.dataset.windows import Windows
from offpiste.training.batches import batches_of, one_ahead
from offpiste.training.distributed import Group


def test_each_item_is_made_while_the_previous_one_is_in_use():
    began = {number: threading.Event() for number in range(4)}

    def make(number):
        began[number].set()
        return 10 * number

    made = one_ahead(make, range(4))
    for number in range(4):
        assert next(made) == 10 * number
        assert number == 3 or began[number + 1].wait(5)
        assert number > 1 or not began[number + 2].is_set()
    assert list(made) == list(one_ahead(make, [])) == []

    def fail(number):
        if number:
            raise ValueError(number)
        return number

    made = one_ahead(fail, range(3))
    assert next(made) == 0
    with pytest.raises(ValueError, match="1"):
        next(made)


@pytest.mark.parametrize("group", [Group(), Group(1, 3)])
def test_batches_gathered_ahead_have_the_same_draws(group, tmp_path):
    windows = Windows(dataset_with_features(tmp_path / "data.zarr", rows=400), "train")
    parts = [np.array(part) for part in ([3, 1, 4], [1], [5, 9, 2, 6])]
    found = []
    for windows.read_ahead in (False, True):
        rng = np.random.default_rng(7)
        found.append(list(batches_of(windows, parts, per_trajectory, rng, group)))
    assert [batch is None for batch in found[0]] == [batch is None for batch in found[1]]
    for one, other in zip(*found, strict=True):
        if one is not None:
            assert torch.equal(one.state, other.state)
            assert torch.equal(one.terrain.normal, other.terrain.normal)
            torch.testing.assert_close(one.ground.features, other.ground.features, rtol=0, atol=0, equal_nan=True)
