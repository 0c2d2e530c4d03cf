"""Topics of single pairs of frames, and the transforms read from them."""

from pathlib import Path

import numpy as np
import pytest

from bag_files import converted
from offpiste.core.errors import LogError
from offpiste.inspection.naming import guess_channels
from offpiste.logs.formats.bag import BagLog
from offpiste.logs.transforms import STAMPED_FIELDS, frame_pair, listed
from sensor_bags import transforms
from sensor_drive import written

STILL = (0, 0, 0, 1)
BODY = "/tf odom -> base_link"


def robot(seconds: float):
    """Return the transforms of a mapping robot and a wheel, stamped 20 ms earlier."""
    chain = [("odom", "base_link", (2 * seconds, seconds, 0), STILL), ("base_link", "wheel", (0, 1, 0), STILL)]
    return transforms(*chain, ("map", "odom", (0.1, 0, 0), STILL), seconds=seconds - 0.02)


def recorded(path: Path, messages) -> BagLog:
    return BagLog(written(path, messages))


def test_a_body_has_a_topic_of_its_own(tmp_path: Path) -> None:
    times = np.arange(0, 20, 0.1)
    others = [(t, "/tf", transforms(("map", "odom", (0.1, 0, 0), STILL), seconds=t)) for t in times + 0.05]
    still = [(0.0, "/tf_static", transforms(("map", "base_marker", (9, 9, 9), STILL)))]
    log = recorded(tmp_path / "log.mcap", [*still, *((t, "/tf", robot(t)) for t in times), *others])
    pairs = ["/tf base_link -> wheel", "/tf map -> odom"]
    assert list(log.topics) == ["/tf", "/tf_static", BODY, *pairs], "bodies first, and nothing that stands"
    assert {guess.topic for guess in guess_channels(log)} == {BODY}, "neither wheels, nor the map's drift"
    assert (log.topics[BODY].fields, log.topics[BODY].part_of) == (STAMPED_FIELDS, "/tf")
    read = log.read(BODY, ("transform.translation.y", "transform.rotation.w"))
    np.testing.assert_allclose(read.values, np.stack([times, np.ones(200)], 1))
    np.testing.assert_allclose(read.time, 100 + times - 0.02)
    np.testing.assert_allclose(log.read(BODY, STAMPED_FIELDS, stamps="receive").time, 100 + times)
    np.testing.assert_array_equal(log.stamps(BODY), read.time)
    assert {message.child_frame_id for _, message in log.messages(BODY)} == {"base_link"}
    with pytest.raises(LogError, match="has no field 'x'"):
        log.read(BODY, ["x"])
    with pytest.raises(LogError, match="no topic '/tf odom -> wheel'; did you mean '/tf odom -> base_link'"):
        log.read("/tf odom -> wheel", STAMPED_FIELDS)


def test_a_body_that_comes_late_is_found(tmp_path: Path) -> None:
    wheel = ("base_link", "wheel", (0, 1, 0), STILL)
    early = [(t, "/tf", transforms(wheel, seconds=t)) for t in np.arange(0, 10, 0.02)]
    log = recorded(tmp_path / "log.mcap", [*early, *((t, "/tf", robot(t)) for t in np.arange(10, 20, 0.05))])
    assert log.topics[BODY].count == 200
    assert len(log.read(BODY, STAMPED_FIELDS).time) == 200


def test_frames_of_ros_1_have_a_slash(tmp_path: Path) -> None:
    """And two robots have two bodies."""
    messages = []
    for k in range(5):
        places = ((f"/{robot}/odom", f"/{robot}/base_link", (x * k, 0, 0), STILL) for robot, x in (("a", 1), ("b", 2)))
        messages.append((float(k), "/tf", transforms(*places, seconds=float(k))))
    log = BagLog(converted(recorded(tmp_path / "log.mcap", messages).path, tmp_path / "log.bag"))
    assert [one for one in log.topics if "->" in one] == ["/tf a/odom -> a/base_link", "/tf b/odom -> b/base_link"]
    read = log.read("/tf b/odom -> b/base_link", ["transform.translation.x"])
    assert read.values[:, 0].tolist() == [0, 2, 4, 6, 8]


def test_messages_list_a_handful_of_many_pairs(tmp_path: Path) -> None:
    legs = [(f"leg_{k}", f"foot_{k}", (0, k, 0), STILL) for k in range(30)]
    log = recorded(tmp_path / "log.mcap", [(0.0, "/tf", transforms(*legs)), (0.1, "/tf", robot(0.1))])
    assert len(log.topics) == 1 + 30 + 3
    assert listed(log.topics) == ["/tf", BODY, *(f"/tf leg_{k} -> foot_{k}" for k in range(5))]
    assert log.read("/tf leg_29 -> foot_29", ["transform.translation.y"]).values.tolist() == [[29.0]]
    with pytest.raises(LogError, match=f"available: /tf, .*{BODY}$"):
        log.read("/odom", ["x"])


def test_frames_say_which_way_round_a_pose_is() -> None:
    named = {"odom -> base_link": (True, False), "base_footprint -> odom": (False, True), "map -> odom": (False, False)}
    for pair, expected in named.items():
        one = frame_pair(f"/tf {pair}")
        assert one is not None
        assert (one.is_of_a_body, one.is_inverse) == expected
