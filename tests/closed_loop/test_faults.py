"""Messages that reach the run time under faults of the sensors."""

from unittest.mock import Mock

import numpy as np
import pytest

from offpiste.closed_loop.faults import KINDS, Fault
from offpiste.logs.measurements import Cloud, Image
from offpiste.runtime.runtime import Runtime

PIXELS = np.zeros((4, 4, 3), np.uint8)


def image(t):
    return Image(t, "eye", PIXELS)


def cloud(t):
    return Cloud(t, "lidar", np.zeros((2, 3)), None, np.zeros(2))


def arriving(kind, *, late=0.8):
    """Stamps of images and clouds that arrive at each tenth of a second of 3 s; the fault begins at 1 s."""
    fault, images, clouds = Fault(kind, 1.0, late), [], []
    for row in range(30):
        t = row / 10
        fault.notice(t, 3.0)
        for measured in [*fault.passed(image(t), t), *fault.passed(cloud(t), t)]:
            (images if isinstance(measured, Image) else clouds).append((t, measured.time))
    return images, clouds


def test_without_a_fault_everything_passes():
    images, clouds = arriving("none")
    assert images == clouds == [(row / 10, row / 10) for row in range(30)]


def test_dropped_sensors_are_silent_from_then_on():
    images, clouds = arriving("camera-dropped")
    assert (len(images), len(clouds)) == (10, 30)
    images, clouds = arriving("lidar-dropped")
    assert (len(images), len(clouds)) == (30, 10)


def test_late_images_come_with_their_own_stamps():
    images, clouds = arriving("late-image")
    assert len(clouds) == 30
    delays = np.array([arrival - stamp for arrival, stamp in images])
    np.testing.assert_allclose(delays[:10], 0)
    np.testing.assert_allclose(delays[10:], 0.8, atol=1e-9)
    assert [stamp for _, stamp in images] == sorted(stamp for _, stamp in images)


def test_features_break_from_then_on():
    fault = Fault("nan-features", 1.0)
    extract = fault.extractor(lambda pixels: np.ones((2, 2, 3), np.float32))
    fault.notice(0.9, 3.0)
    assert np.isfinite(extract(PIXELS)).all()
    fault.notice(1.0, 3.0)
    assert np.isnan(extract(PIXELS)).all()


def test_the_empty_map_fault_moves_echoes_far_above():
    fault = Fault("map-empty", 1.0)
    fault.notice(1.5, 3.0)
    (found,) = fault.passed(cloud(1.5), 1.5)
    assert (found.points[:, 2] == 1000).all()


@pytest.mark.parametrize("kind", KINDS)
def test_only_the_empty_map_fault_empties_the_map_and_once(kind):
    runtime, fault = Mock(spec=Runtime), Fault(kind, 1.0)
    fault.notice(0.98, 3.0)
    fault.strike(runtime)
    runtime.forget_map.assert_not_called()
    for time in (1.0, 1.02, 5.0):
        fault.notice(time, 3.0)
        fault.strike(runtime)
    assert runtime.forget_map.call_count == (1 if kind == "map-empty" else 0)


def test_a_fault_in_reverse_waits_for_its_time_and_the_gear_and_then_stays():
    fault = Fault("lidar-dropped", 1.0, when="reversing")
    for time, rolling, passes in ((0.5, -2.0, 1), (1.0, 3.0, 1), (1.5, -0.2, 1), (2.0, -0.6, 0), (2.5, 3.0, 0)):
        fault.notice(time, rolling)
        assert len(fault.passed(cloud(time), time)) == passes, time
