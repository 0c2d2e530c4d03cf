"""Ranges of controls: by what loggers write, not by what one drive happened to reach."""

import numpy as np
import pytest
from simulated import rig

from offpiste.inspection.usual_ranges import (
    are_pulses,
    held_range,
    pulse_at_rest,
    rests_between,
    rests_high,
    scaled_to_unit,
    seen_range,
    steering_middle,
    whole_range,
)
from offpiste.logs.channel import convert
from offpiste.rig.channels import ChannelSource

VEHICLE = rig().vehicle
WAVE = np.sin(np.arange(4000) / 37)


def presses(low: float, high: float, *, rest: float, share: float = 0.2) -> np.ndarray:
    """A pedal that rests at one value and is pressed to others for a share of the time, slowly."""
    t = np.linspace(0, 40, 2000)
    pressed = np.clip(np.sin(t) - 1 + 2 * share, 0, None) / (2 * share)
    away = high if rest == low else low
    return rest + (away - rest) * pressed


@pytest.mark.parametrize(
    ("low", "high", "rest", "whole"),
    [
        (0.0, 83.75, 0.0, (0.0, 100.0)),
        (0.0, 210.0, 0.0, (0.0, 255.0)),
        (0.0, 0.6, 0.0, (0.0, 1.0)),
        (-0.634, 1.0, 1.0, (-1.0, 1.0)),
        (-1.0, 0.3, -1.0, (-1.0, 1.0)),
        (-32767.0, 1000.0, -32767.0, (-32767.0, 32767.0)),
        (1500.0, 1900.0, 1500.0, None),
        (0.0, 0.3, 0.0, None),
        (-0.5, 0.5, 0.5, None),
    ],
)
def test_the_whole_range_is_that_of_usual_loggers(
    low: float, high: float, rest: float, whole: tuple[float, float] | None
) -> None:
    assert whole_range(presses(low, high, rest=rest)) == whole


def test_a_spike_is_no_range_and_a_rare_press_is_one() -> None:
    values = np.zeros(1000)
    values[500] = 900.0
    values[600:606] = 80.0
    assert held_range(values) == (0.0, 80.0)


def test_readings_beyond_the_rest_are_not_seen() -> None:
    values = presses(11, 20, rest=11.0)
    values[:4] = 0.0  # before the sensor wakes up
    low, high = seen_range(values)
    assert low == pytest.approx(11.0)
    assert high == pytest.approx(20.0, abs=0.1)
    assert seen_range(-values)[1] == pytest.approx(-11.0)


def test_a_pressure_that_decays_to_nothing_rests_at_zero() -> None:
    values = np.maximum(presses(0, 45, rest=0.0), 2e-189)
    assert seen_range(values)[0] == 0.0
    assert seen_range(-values)[1] == 0.0


def test_where_a_pedal_rests() -> None:
    assert rests_high(presses(-1, 1, rest=1.0)) is True
    assert rests_high(presses(0, 1, rest=0.0)) is False
    assert rests_high(np.linspace(0, 1, 1000)) is None


@pytest.mark.parametrize("turned", [False, True])
def test_edits_bring_any_conversion_to_0_to_1(turned: bool) -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        scale, offset = rng.uniform(0.1, 5), rng.uniform(-3, 3)
        source = ChannelSource(("a",), scale=scale, offset=offset, sign=int(rng.choice((-1, 1))), unit="percent")
        raw = rng.uniform(-10, 10, (50, 1))
        values = convert("throttle", source, raw, VEHICLE)
        span = float(values.min()), float(values.max())
        edits = {e.key.rpartition(".")[2]: e.value for e in scaled_to_unit("throttle", source, span, turned=turned)}
        fixed = ChannelSource(("a",), sign=source.sign, unit="percent", **{"scale": scale, "offset": offset} | edits)
        wanted = (values - span[0]) / (span[1] - span[0])
        np.testing.assert_allclose(
            convert("throttle", fixed, raw, VEHICLE), 1 - wanted if turned else wanted, atol=2e-3
        )


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
    # A stick that is released at the middle pulse, and at times pulled to the least one.
    assert pulse_at_rest(1500 + 500 * _two_way()) == 1500


def _two_way() -> np.ndarray:
    """A throttle that is released, at full size forwards and, less often, at full size backwards."""
    return np.concatenate((np.zeros(400), np.ones(300), -np.ones(200), np.linspace(-1, 1, 600)))


def test_a_pedal_that_is_released_between_its_ends_goes_both_ways() -> None:
    for size, middle in ((0.8, 0.0), (100.0, 0.0), (400.0, 1500.0)):
        assert rests_between(middle + size * _two_way(), middle)
    for trigger in (presses(-1, 1, rest=1.0), presses(-1, 1, rest=-1.0), presses(0, 1, rest=0.0)):
        assert not rests_between(trigger)
    assert not rests_between(presses(1000, 2000, rest=1000.0), 1500.0)


@pytest.mark.parametrize("value", [0.0, 1500.0, 1e9])
def test_a_steering_that_is_never_turned_has_no_middle(value: float) -> None:
    assert steering_middle(np.full(500, value), named=True) is None
