import numpy as np
import pytest

from offpiste.conventions import HISTORY_STEPS, HORIZON_STEPS
from offpiste.evaluation.intervals import blocks, paired, relative, resampling, summary


def drawn(block: np.ndarray | list[int], seed: int = 0):
    return resampling(np.asarray(block, dtype=np.int64), np.random.default_rng(seed))


def test_statistics_worked_by_hand() -> None:
    values = np.array([1.0, 2.0, 3.0, 4.0, 10.0])
    found = summary(values, drawn([0, 1, 2, 3, 4]))
    assert (found.mean, found.median, found.q1, found.q3) == (4.0, 3.0, 2.0, 4.0)
    assert found.p90 == pytest.approx(7.6)  # between the 4th and the 5th value: 4 + 0.6 * 6
    assert found.ci95[0] < 4.0 < found.ci95[1]


@pytest.mark.parametrize("count", [1, 2])
def test_fewer_than_three_blocks_have_no_interval(count: int) -> None:
    values = np.arange(10.0)
    block = np.arange(10) % count
    assert np.isnan(summary(values, drawn(block)).ci95).all()
    assert np.isnan(paired(values, values + 1, drawn(block)).ci95).all()
    assert paired(values, values + 1, drawn(block)).mean == -1.0


def test_equal_values_have_an_interval_of_no_width() -> None:
    assert summary(np.full(30, 2.5), drawn(np.arange(30) // 5)).ci95 == pytest.approx((2.5, 2.5))


@pytest.mark.parametrize("groups", [6, 20])
def test_intervals_hold_the_truth_about_95_times_in_100(groups: int) -> None:
    """Windows of a block are copies of each other; an interval over windows would hold it far less often."""
    rng = np.random.default_rng(1)
    block = np.repeat(np.arange(groups), 30)
    blocked = naive = 0
    for seed in range(300):
        values = rng.normal(5.0, 1.0, groups)[block]
        low, high = summary(values, drawn(block, seed)).ci95
        blocked += low <= 5.0 <= high
        half = 1.96 * values.std() / np.sqrt(len(values))
        naive += abs(values.mean() - 5.0) <= half
    assert 0.90 <= blocked / 300 <= 0.985
    assert naive / 300 < 0.5


def test_blocks_of_unequal_size_count_by_their_windows() -> None:
    values = np.array([0.0, 0.0, 0.0, 0.0, 4.0, 8.0])
    sample = drawn([0, 0, 0, 0, 1, 2])
    assert summary(values, sample).mean == 2.0
    draws = sample.draws[0]
    by_hand = (4 * draws[1] + 8 * draws[2]) / (4 * draws[0] + draws[1] + draws[2])
    assert sample.means(values)[0] == pytest.approx(by_hand)


def test_the_same_seed_gives_the_same_interval() -> None:
    values, block = np.random.default_rng(0).normal(size=100), np.arange(100) // 10
    assert summary(values, drawn(block, 3)) == summary(values, drawn(block, 3))
    assert summary(values, drawn(block, 3)) != summary(values, drawn(block, 4))


def test_a_paired_difference_is_negative_for_the_better_model_and_narrow() -> None:
    rng = np.random.default_rng(2)
    hard = np.repeat(rng.uniform(1, 9, 20), 10)  # how hard a place is, is common to both models
    block = np.arange(200) // 10
    better, worse = hard + rng.normal(0, 0.1, 200), hard + 0.5 + rng.normal(0, 0.1, 200)
    found = paired(better, worse, drawn(block))
    assert found.mean == pytest.approx(-0.5, abs=0.05)
    assert found.ci95[0] < -0.4
    assert found.ci95[1] < 0
    assert paired(worse, better, drawn(block)).mean == -found.mean
    single = summary(better, drawn(block)).ci95
    assert found.ci95[1] - found.ci95[0] < 0.2 * (single[1] - single[0])


def test_relative_is_a_ratio_of_means() -> None:
    other = np.tile([2.0, 4.0, 6.0], 10)
    found = relative(0.7 * other, other, drawn(np.arange(30) // 3))
    assert found.mean == pytest.approx(-0.3)
    assert found.ci95 == pytest.approx((-0.3, -0.3))


def test_failed_predictions_make_the_mean_infinite_and_leave_low_quantiles() -> None:
    values = np.array([1.0, 2.0, 3.0, 4.0, np.inf])
    found = summary(values, drawn([0, 1, 2, 3, 4]))
    assert found.mean == np.inf
    assert (found.q1, found.median, found.q3, found.p90) == (2.0, 3.0, 4.0, np.inf)
    assert np.isnan(found.ci95).all()
    assert paired(values, np.ones(5), drawn([0, 1, 2, 3, 4])).mean == np.inf
    assert paired(np.ones(5), values, drawn([0, 1, 2, 3, 4])).mean == -np.inf
    assert np.isnan(relative(values, np.ones(5), drawn([0, 1, 2, 3, 4])).mean)


def test_blocks_do_not_mix_drives() -> None:
    drive = np.repeat([0, 1, 2], 100)
    row = np.tile(np.arange(100) * 5, 3)
    block = blocks(drive, row)
    assert all(len(set(drive[block == b])) == 1 for b in set(block))


@pytest.mark.parametrize("gaps", [False, True])
def test_windows_of_a_block_and_of_the_next_but_one_share_no_row(gaps: bool) -> None:
    row = np.arange(0, 6000, 5)
    if gaps:
        row = row[np.random.default_rng(0).random(len(row)) < 0.1]
    block = blocks(np.zeros(len(row), dtype=int), row)
    assert (np.diff(block) >= 0).all()
    assert set(block) == set(range(block.max() + 1))
    for b in range(block.max() - 1):
        last_of_this, first_after_next = row[block == b].max(), row[block == b + 2].min()
        assert first_after_next - last_of_this > HISTORY_STEPS + HORIZON_STEPS


def test_left_over_windows_join_the_last_block() -> None:
    row = np.arange(0, 1100, 5)  # 22 s: two blocks of 10 s, and 2 s left
    block = blocks(np.zeros(len(row), dtype=int), row)
    assert block.max() == 1
    assert (block[row < 500] == 0).all()
    assert (block[row >= 500] == 1).all()
    assert blocks(np.zeros(len(row), dtype=int), row, seconds=6.0).max() == 3  # 6, 6, 6 and 4 s


def test_windows_far_apart_are_not_one_block() -> None:
    row = np.array([0, 5, 10, 5000, 5005])
    assert blocks(np.zeros(5, dtype=int), row).tolist() == [0, 0, 0, 1, 1]
