"""Controls whose middle lies above zero: pulses and counts."""

import numpy as np
import pytest

from offpiste.inspection.middle_ranges import are_pulses, pulse_at_rest, steering_middle

WAVE = np.sin(np.arange(4000) / 37)


@pytest.mark.parametrize(
    ("values", "middle", "reach"),
    [
        (1500 + 400 * WAVE, 1500, 400),
        (512 + 420 * WAVE, 511.5, 511.5),
        (128 + 100 * WAVE, 127.5, 127.5),
        (50 + 45 * WAVE, 50, 50),
        (2048 + 1500 * WAVE, 2047.5, 2047.5),
        (90 + 60 * WAVE, 90, 90),
    ],
    ids=["pulses", "10 bits", "8 bits", "percent", "12 bits", "degrees of a servo"],
)
def test_the_middle_of_what_loggers_write(values: np.ndarray, middle: float, reach: float) -> None:
    found = steering_middle(values, named=False)
    assert found is not None
    assert found[:2] == (middle, pytest.approx(reach, rel=0.01))


def test_numbers_of_no_such_range_lie_around_their_own_middle() -> None:
    middle, reach, words = steering_middle(7000 + 300 * WAVE, named=False) or (0, 0, "")
    assert (middle, reach) == (pytest.approx(7000, abs=5), pytest.approx(300, rel=0.02))
    assert "is their middle straight ahead?" in words


@pytest.mark.parametrize("values", [500 * WAVE, 90 * WAVE - 20, np.maximum(WAVE, 0) * 0])
def test_numbers_on_both_sides_of_zero_have_no_other_middle(values: np.ndarray) -> None:
    assert steering_middle(values, named=False) is None


def test_pulses_on_one_side_need_a_name() -> None:
    driving = 1650 + 100 * WAVE
    assert are_pulses(driving, named=True)
    assert not are_pulses(driving, named=False)
    assert not are_pulses(800 + 300 * WAVE, named=True)


def test_where_a_speed_controller_rests() -> None:
    assert pulse_at_rest(1650 + 100 * WAVE) == 1500
    assert pulse_at_rest(1500 + 400 * WAVE) == 1500
    assert pulse_at_rest(np.clip(1000 + 900 * WAVE, 1000, 2000)) == 1000
