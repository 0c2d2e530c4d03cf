"""What models read while they train: which sets, for how long, and that the seed alone decides."""

import numpy as np
import pytest

from offpiste.conventions import FEATURE_SETS, HISTORY_STEPS
from offpiste.dataset.feature_sets import masked, per_step, per_trajectory
from offpiste.dynamics import MODELS

STORED = len(FEATURE_SETS)


def test_dc_keeps_a_set_for_the_trajectory_and_draws_all_alike():
    feature_set_choice = per_trajectory(np.random.default_rng(0), 8000, 250, STORED)
    assert feature_set_choice.sets.shape == (8000, 1)
    assert not feature_set_choice.flags_only
    counts = np.bincount(feature_set_choice.sets[:, 0], minlength=STORED)
    assert len(counts) == STORED
    assert np.abs(counts - 1000).max() < 5 * np.sqrt(1000)


def test_dc_step_draws_at_every_row():
    feature_set_choice = per_step(np.random.default_rng(0), 50, 30, STORED)
    assert feature_set_choice.sets.shape == (50, HISTORY_STEPS + 30)
    assert (np.diff(feature_set_choice.sets, axis=1) == 0).mean() == pytest.approx(1 / STORED, abs=0.03)


def test_masked_takes_flags_alone():
    assert masked(np.random.default_rng(0), 5, 30, STORED).flags_only


def test_the_generator_decides():
    for draw in (per_trajectory, per_step, masked):
        one, other = (draw(np.random.default_rng(3), 40, 20, STORED).sets for _ in range(2))
        np.testing.assert_array_equal(one, other)


def test_models_say_how_they_draw():
    drawing = {name: model.draw for name, model in MODELS.items() if model.draw is not None}
    assert drawing == {"dc": per_trajectory, "dc-hold": per_trajectory, "dc-step": per_step, "cf-masked": masked}
