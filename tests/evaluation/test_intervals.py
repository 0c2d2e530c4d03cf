"""Intervals: coverage of the truth, hand-worked draws, blocks."""

import numpy as np
import pytest

from offpiste.core.conventions import HISTORY_STEPS, HORIZON_STEPS
from offpiste.evaluation.errors import Errors
from offpiste.evaluation.intervals import (
    RESAMPLES,
    Levels,
    Resampling,
    Sampling,
    blocks,
    paired,
    relative,
    resampling,
    summary,
)


def drawn(block: np.ndarray | list[int], seed: int = 0, resamples: int = RESAMPLES) -> Resampling:
    """Blocks of one drive."""
    block = np.asarray(block, dtype=np.int64)
    return resampling(np.zeros(len(block), np.int64), block, seed, resamples=resamples)


def nested(drives: int, per_drive: int, windows: int, seed: int = 0, resamples: int = RESAMPLES) -> Resampling:
    """Drives of as many blocks of as many windows each."""
    block = np.repeat(np.arange(drives * per_drive), windows)
    return resampling(block // per_drive, block, seed, resamples=resamples)


def test_statistics_worked_by_hand() -> None:
    values = np.array([1.0, 2.0, 3.0, 4.0, 10.0])
    found = summary(values, drawn([0, 1, 2, 3, 4]))
    assert (found.mean, found.median, found.q1, found.q3) == (4.0, 3.0, 2.0, 4.0)
    assert found.p90 == pytest.approx(7.6)  # between the 4th and the 5th value: 4 + 0.6 * 6
    assert found.ci95[0] < 4.0 < found.ci95[1]


def test_fewer_than_five_drives_or_blocks_of_one_drive_have_no_interval() -> None:
    values, block = np.arange(12.0), np.arange(12) % 4
    assert np.isnan(summary(values, drawn(block)).ci95).all()
    found = paired(values, values + 1, drawn(block))
    assert (found.mean, *np.isnan(found.ci95)) == (-1.0, True, True)
    sample = nested(4, 10, 2)
    assert np.isnan(summary(np.arange(80.0), sample).ci95).all(), "blocks of four drives are not independent"


def test_levels_state_what_intervals_are_over() -> None:
    sample = nested(1, 10, 2)
    assert sample.levels(2) == Levels(1, 10, 2)
    assert (sample.draws.sum(axis=1) == 10).all()
    assert sample.levels(2).text() == "10 blocks of one drive, 2 seeds"
    assert sample.levels().caveat == "Intervals are over blocks of one drive and say nothing about other drives."
    assert nested(5, 5, 2).levels().caveat == ""
    few = "–: no interval, since there are only 4 drives and 5 drives are needed."
    assert nested(4, 10, 2).levels().caveat == few


@pytest.mark.parametrize("drives", [1, 5])
def test_the_interval_of_a_distance_stays_above_zero(drives: int) -> None:
    """With a single bad block or world."""
    sample = nested(drives, 6, 1)
    values = np.full(6 * drives, 0.3)
    values[:6] = 20.0
    values[3] = 40.0
    low, high = summary(values, sample).ci95
    assert 0 < low < values.mean() < high
    low, high = relative(values, 0.01 + values[::-1], sample).ci95
    assert low > -1


@pytest.mark.parametrize(("drives", "per_drive"), [(1, 5), (5, 10)])
def test_intervals_of_five_units_hold_the_truth_nine_times_in_ten(drives: int, per_drive: int) -> None:
    """Percentiles end at the farthest unit."""
    rng, sample = np.random.default_rng(7), nested(drives, per_drive, 1)
    held = 0
    for _ in range(500):
        world = np.repeat(rng.normal(5.0, float(drives > 1), drives), per_drive)
        low, high = summary(rng.normal(world, 0.2 if drives > 1 else 1.0), sample).ci95
        held += low <= 5.0 <= high
    assert 0.88 <= held / 500 <= 0.98


def test_a_paired_difference_is_negative_for_the_better_model_and_narrow() -> None:
    rng, block = np.random.default_rng(2), np.arange(200) // 10
    hard = np.repeat(rng.uniform(1, 9, 20), 10)  # how hard a place is, is common to both models
    better, worse = hard + rng.normal(0, 0.1, 200), hard + 0.5 + rng.normal(0, 0.1, 200)
    found = paired(better, worse, drawn(block))
    assert found.mean == pytest.approx(-0.5, abs=0.05)
    assert -0.6 < found.ci95[0] < found.ci95[1] < -0.4
    assert np.ptp(found.ci95) < 0.2 * np.ptp(summary(better, drawn(block)).ci95)
    ratio = relative(0.7 * worse, worse, drawn(block))
    assert (ratio.mean, *ratio.ci95) == pytest.approx((-0.3, -0.3, -0.3))


def test_failed_predictions_make_the_mean_infinite_and_leave_low_quantiles() -> None:
    values = np.array([1.0, 2.0, 3.0, 4.0, np.inf])
    found = summary(values, drawn([0, 1, 2, 3, 4]))
    assert found.mean == np.inf
    assert (found.q1, found.median, found.q3, found.p90) == (2.0, 3.0, 4.0, np.inf)
    assert np.isnan(found.ci95).all()
    assert paired(values, np.ones(5), drawn([0, 1, 2, 3, 4])).mean == np.inf
    assert paired(np.ones(5), values, drawn([0, 1, 2, 3, 4])).mean == -np.inf
    assert np.isnan(relative(values, np.ones(5), drawn([0, 1, 2, 3, 4])).mean)


def test_intervals_hold_the_truth_about_worlds_where_pooled_blocks_do_not() -> None:
    """Worlds differ as much as blocks do; the truth is the mean over all worlds."""
    rng, drives = np.random.default_rng(3), 5
    hierarchical = pooled = 0
    for seed in range(300):
        world = np.repeat(rng.normal(5.0, 1.0, drives), 4)
        values = np.repeat(world + rng.normal(0.0, 1.0, 4 * drives), 3)
        low, high = summary(values, nested(drives, 4, 3, seed, 1000)).ci95
        hierarchical += low <= 5.0 <= high
        low, high = summary(values, drawn(np.repeat(np.arange(4 * drives), 3), seed, 1000)).ci95
        pooled += low <= 5.0 <= high
    assert 0.92 <= hierarchical / 300 <= 0.99
    assert pooled / 300 < 0.8


def test_intervals_hold_the_truth_about_seeds_where_their_mean_alone_does_not() -> None:
    """Runs of a model differ as much as its worlds do; the truth is the mean over all runs."""
    rng = np.random.default_rng(4)
    seeded = of_mean = 0
    for seed in range(300):
        world = np.repeat(rng.normal(5.0, 1.0, 8), 4)
        values = world + rng.normal(0.0, 0.4, 32) + rng.normal(0.0, 0.5, (3, 1))
        sample = nested(8, 4, 1, seed, 1000)
        low, high = summary(values, sample).ci95
        seeded += low <= 5.0 <= high
        low, high = summary(values.mean(axis=0), sample).ci95
        of_mean += low <= 5.0 <= high
    assert 0.91 <= seeded / 300 <= 0.985
    assert seeded > of_mean + 10


def test_draws_of_drives_and_blocks_have_the_right_weights() -> None:
    # Drive 0 has blocks 0, 1; drive 1 has block 2; drive 2 has blocks 3, 4, 5.
    block = np.arange(6)
    sample = resampling(np.array([0, 0, 1, 2, 2, 2]), block, 0, resamples=4000)
    times = np.stack((sample.draws[:, :2].sum(axis=1) / 2, sample.draws[:, 2], sample.draws[:, 3:].sum(axis=1) / 3))
    assert (times == times.round()).all()  # a drawn drive is drawn with as many blocks as it has
    assert (times.sum(axis=0) == 3).all()
    np.testing.assert_allclose(times.mean(axis=1), 1.0, atol=0.05)
    np.testing.assert_allclose(times.var(axis=1), 3 * (1 / 3) * (2 / 3), atol=0.05)
    once = times[0] == 1
    np.testing.assert_allclose((sample.draws[once, 0][:, None] == [0, 1, 2]).mean(axis=0), [0.25, 0.5, 0.25], atol=0.05)
    values = np.array([3.0, 1.0, 4.0, 1.0, 5.0, 9.0])
    by_hand = sample.draws[7] @ values / sample.draws[7].sum()
    assert sample.means(values)[7] == pytest.approx(by_hand)
    assert (sample.drives, sample.levels(3)) == (3, Levels(3, 6, 3))
    assert Levels(3, 6, 1).text() == "3 drives, 6 blocks, 1 seed"


def test_seeds_are_drawn_with_all_windows_and_weigh_alike() -> None:
    sample = nested(4, 2, 2)
    values = np.random.default_rng(0).normal(size=(3, 16))
    seeds = sample.seed_draws(3)
    assert (seeds.sum(axis=1) == 2).all()  # one less than there are
    single = np.stack([sample.means(run) for run in values], axis=1)
    np.testing.assert_allclose(sample.means(values), (single * seeds).sum(axis=1) / 2)
    np.testing.assert_allclose(sample.means(values[:1]), sample.means(values[0]))
    # The variance of the mean over seeds is that of independent runs: s^2 / 3, not 2/3 of it.
    runs = np.array([[1.0], [2.0], [6.0]]) * np.ones(16)
    assert sample.means(runs).var() == pytest.approx(np.var([1, 2, 6], ddof=1) / 3, rel=0.1)


def test_models_are_compared_on_the_same_draws_of_seeds() -> None:
    rng = np.random.default_rng(5)
    sample, luck = nested(6, 3, 2), rng.normal(0, 1, (3, 1))  # of a seed, common to both models
    other = 5 + luck + rng.normal(0, 0.1, (3, 36))
    found = paired(other - 0.5, other, sample)
    assert (found.mean, *found.ci95) == pytest.approx((-0.5, -0.5, -0.5))
    assert np.ptp(summary(other, sample).ci95) > 1
    # A model with one run, as a baseline that is not trained, is the same for every seed.
    assert np.ptp(paired(other, other[0], sample).ci95) > 1


def test_the_order_of_windows_does_not_matter() -> None:
    rng = np.random.default_rng(6)
    drive, row = np.repeat(np.arange(5), 40), np.tile(np.arange(40) * 50, 5)
    values = rng.normal(size=(200, 5, 5))
    errors = Errors(drive, row, values, values[:, 0, 0])
    mixed = errors.take(rng.permutation(200))
    one, other = (summary(e.loss, Sampling().on(e)) for e in (errors, mixed))
    assert other.ci95 == pytest.approx(one.ci95)
    assert other.mean == pytest.approx(one.mean)
    assert Sampling().on(errors).levels() == Levels(5, 20)


def test_windows_of_a_block_and_of_the_next_but_one_share_no_row() -> None:
    row = np.arange(0, 6000, 5)
    row = row[np.random.default_rng(0).random(len(row)) < 0.1]
    block = blocks(np.zeros(len(row), dtype=int), row)
    assert (np.diff(block) >= 0).all()
    assert set(block) == set(range(block.max() + 1))
    for b in range(block.max() - 1):
        last_of_this, first_after_next = row[block == b].max(), row[block == b + 2].min()
        assert first_after_next - last_of_this > HISTORY_STEPS + HORIZON_STEPS


def test_short_rests_join_the_last_block_and_gaps_separate_blocks() -> None:
    row = np.arange(0, 1100, 5)  # 22 s: two blocks of 10 s, and 2 s left
    block = blocks(np.zeros(len(row), dtype=int), row)
    assert block.tolist() == [int(r >= 500) for r in row]
    assert blocks(np.zeros(len(row), dtype=int), row, seconds=6.0).max() == 3  # 6, 6, 6 and 4 s
    row = np.array([0, 5, 10, 5000, 5005])
    assert blocks(np.zeros(5, dtype=int), row).tolist() == [0, 0, 0, 1, 1]
    assert blocks(np.array([0, 0, 1, 1, 1]), np.array([0, 5, 0, 5, 10])).tolist() == [0, 0, 1, 1, 1]
