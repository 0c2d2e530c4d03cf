"""Clocks against each other: planted offsets and drifts come back, whatever delays the messages."""

import numpy as np
import pytest

from offpiste.errors import LogError
from offpiste.logs.coverage import clock_difference, clock_note
from sensor_bags import IMAGE, cloud, compressed, info, opened, record, tree

STILL = [(0, "/tf_static", tree()), (0, "/info", info())]


@pytest.mark.parametrize("drift", [-0.3, 0.0, 0.08])
@pytest.mark.parametrize("offset", [-2.0, 0.05])
def test_offset_and_drift_come_back(offset, drift):
    rng = np.random.default_rng(0)
    pose, image = np.arange(0, 60, 0.02), np.arange(0, 60, 0.5)
    pose_arrivals = pose + rng.exponential(0.005, len(pose))
    arrivals = image + 0.01 + rng.exponential(0.03, len(image))  # a camera sends late, and sometimes very late
    stamps = image - offset - drift * (image - 30) / 60
    found = clock_difference(stamps, arrivals, pose, pose_arrivals)
    assert found is not None
    assert found[0] == pytest.approx(offset + 0.01, abs=0.01)
    assert found[1] == pytest.approx(drift, abs=0.02)


def test_a_clock_that_all_share_is_no_drift():
    """The whole vehicle's clock against the recorder's."""
    pose, image = np.arange(0, 60, 0.02), np.arange(0, 60, 0.5)
    assert clock_difference(1.01 * image, image, 1.01 * pose, pose) == pytest.approx((0.0, 0.0), abs=0.006)


def test_too_little_says_nothing():
    none = np.zeros(0)
    assert clock_difference(none, none, none, none) is None
    assert clock_difference(np.ones(1), np.ones(1), np.ones(5), np.arange(5.0)) is None


def test_what_is_said():
    assert clock_note("front", 0.1, 0.01) == []
    assert clock_note("front", 0.1, -0.05) == ["front: its stamps drift against the poses' by 50 ms over the drive"]
    assert clock_note("front", -3.0, 0.0) == [
        "front: stamped 3.00 s after poses that arrive with it; mend its clock or its delay"
    ]


def with_drift(path, drift: float):
    """Ten seconds; the camera's clock runs ahead of the true time by and by."""
    arrive = np.arange(0, 10.05, 0.25).tolist()
    messages = [(t, "/image", compressed(t * (1 + drift / 10), IMAGE)) for t in arrive]
    messages += [(t, "/points", cloud(t)) for t in arrive]
    return opened(record(path, [*STILL, *messages], until=10.0))


def test_a_camera_that_drifts_is_told_and_then_refused(tmp_path):
    assert with_drift(tmp_path / "none.mcap", 0.0).coverage() == ()
    (said,) = with_drift(tmp_path / "some.mcap", 0.1).coverage()
    assert said == "front: its stamps drift against the poses' by 101 ms over the drive"
    wrong = r"x\.mcap: 'front': its stamps drift against the poses' by 0\.5. s over the drive; use clock\.stamps"
    with pytest.raises(LogError, match=wrong):
        with_drift(tmp_path / "x.mcap", 0.5).coverage()
