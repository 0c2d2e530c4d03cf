"""A first rig of a log with a camera and a LiDAR: what it says of them, and what it says is missing."""

from pathlib import Path

import numpy as np
import pytest

from offpiste.cli import main
from offpiste.core.errors import LogError
from offpiste.inspection.draft_sensors import draft_sensors, missing
from offpiste.logs import open_log
from offpiste.logs.ros.writer import quaternion
from offpiste.logs.sensor_log import open_sensors
from offpiste.rig.rig import parse_rig
from sensor_bags import IMAGE, cloud, compressed, info, odometry, record, sensor_rig, tree

SCAN = np.random.default_rng(0).uniform(1, 5, (150, 3))


def turning(seconds: float):
    """A pose that turns: a heading that never changes may be one that is never measured."""
    message = odometry(seconds)
    message.pose.pose.orientation = quaternion((0, 0, np.sin(seconds / 4), np.cos(seconds / 4)))
    return message


def recorded(path: Path, **left_out: bool) -> Path:
    """One image and one scan of 150 points beside a cloud of three, without some of what they need."""
    messages = [
        (0.2, "/front/image_raw/compressed", compressed(0.1, IMAGE)),
        (0.3, "/front/depth/compressed", compressed(0.2, IMAGE)),
        (0.25, "/top/points", cloud(0.2, SCAN)),
        (0.25, "/wheels/points", cloud(0.2)),
    ]
    messages += [(t, "/odom", turning(t)) for t in np.arange(0.05, 1, 0.1).tolist()]
    messages += [] if left_out.get("info") else [(0, "/front/camera_info", info())]
    messages += [] if left_out.get("transforms") else [(0, "/tf_static", tree())]
    return record(path, messages)


def test_the_draft_can_be_read_through(tmp_path: Path) -> None:
    log = open_log(recorded(tmp_path / "log.mcap"))
    text = draft_sensors(log, "/odom")
    rig = sensor_rig(text)
    assert {name: camera.topic for name, camera in rig.cameras.items()} == {"front": "/front/image_raw/compressed"}
    assert {name: lidar.topic for name, lidar in rig.lidars.items()} == {"top": "/top/points"}
    assert rig.cameras["front"].info == "/front/camera_info"
    assert rig.frames.body == "base_link"
    # A mast of 2 m, and the LiDAR half a metre above it.
    sensors = open_sensors(log, rig)
    assert sensors.lidars["top"].body_from_lidar[:3, 3] == pytest.approx([1, 0, 2.5])
    top = rig.lidars["top"]
    assert (top.time_field, top.time_unit, top.time_origin) == ("t", "ns", "stamp")
    assert missing(text) == []


def test_what_the_log_does_not_say_is_missing(tmp_path: Path) -> None:
    text = draft_sensors(open_log(recorded(tmp_path / "log.mcap", info=True, transforms=True)), "/odom")
    rig = sensor_rig(text)
    assert not rig.cameras, "a camera without calibration waits in comments"
    assert "# [cameras.front]" in text
    lines = missing(text)
    assert any(line.startswith("transforms: no TF") for line in lines)
    assert any(line.startswith("calibration of front: no CameraInfo") for line in lines)
    assert any(line.startswith("mounting of top: no fixed transform joins 'lidar' to 'base_link'") for line in lines)
    given = rig.lidars["top"].body_from_lidar
    assert given is not None
    assert given.looks == "forward"
    with pytest.raises(LogError, match="the mounting of 'top' is a rough guess"):
        open_sensors(open_log(tmp_path / "log.mcap"), rig)


def test_images_of_16_bits_are_drafted_with_the_bits_that_they_use(tmp_path: Path) -> None:
    deep = np.arange(48, dtype=np.uint16).reshape(6, 8, 1) * 80
    message = compressed(0.2, deep, "mono16; png compressed ")
    messages = [(0.2, "/cam/image/compressed", message), (0, "/cam/camera_info", info()), (0, "/tf_static", tree())]
    log = open_log(record(tmp_path / "log.mcap", messages))
    rig = sensor_rig(draft_sensors(log, "/odom"))
    assert rig.cameras["cam"].bits == 12
    image = next(open_sensors(log, rig).stream(["cam"]))
    assert (image.pixels.min(), image.pixels.max()) == (0, round(47 * 80 * 255 / 4095))


def test_a_topic_without_pictures_waits_in_comments(tmp_path: Path) -> None:
    message = compressed(0.2, np.zeros((6, 8, 1), np.uint16), "16UC1; png compressed ")
    messages = [(0.2, "/cam/image/compressed", message), (0, "/cam/camera_info", info()), (0, "/tf_static", tree())]
    text = draft_sensors(open_log(record(tmp_path / "log.mcap", messages)), "/odom")
    assert not sensor_rig(text).cameras
    (line,) = missing(text)
    assert line.startswith("pictures of cam: topic '/cam/image/compressed' holds images encoded as '16UC1', which are")


def test_two_cameras_have_their_own_calibration_and_name(tmp_path: Path) -> None:
    messages = [(0.2, f"/{side}/image/compressed", compressed(0.1, IMAGE)) for side in ("left", "right")]
    messages += [(0, f"/{side}/camera_info", info()) for side in ("left", "right")]
    messages += [(0.2, "/image", compressed(0.1, IMAGE)), (0, "/tf_static", tree())]
    text = draft_sensors(open_log(record(tmp_path / "log.mcap", messages)), "/odom")
    rig = sensor_rig(text)
    assert {name: c.info for name, c in rig.cameras.items()} == {
        "left": "/left/camera_info",
        "right": "/right/camera_info",
    }
    assert any(line.startswith("calibration of camera: no CameraInfo beside /image") for line in missing(text))


def test_the_command_says_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = recorded(tmp_path / "log.mcap", info=True)
    with pytest.raises(SystemExit):
        main(["inspect", str(log), "--write-rig", str(tmp_path / "my.toml")])
    printed = capsys.readouterr().err
    assert f"wrote {tmp_path / 'my.toml'}\n" in printed
    assert "  missing: calibration of front" in printed
    assert "  missing: steering: no field looks like it" in printed
    assert "All topics are named like measurements." in printed
    parse_rig((tmp_path / "my.toml").read_text(), where="my.toml")
