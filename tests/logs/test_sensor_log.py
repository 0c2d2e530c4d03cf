"""Cameras and LiDARs of a log: order, calibration, cleaning, and errors in one line."""

import numpy as np
import pytest

from offpiste.core.errors import OffpisteError
from offpiste.logs import open_log
from offpiste.logs.measurements import Cloud, Image
from offpiste.logs.ros.sensor_messages import message_from_points
from offpiste.logs.sensor_log import open_sensors
from point_clocks import PointClock
from sensor_bags import (
    IMAGE,
    POINTS,
    SENSORS,
    cloud,
    compressed,
    info,
    opened,
    raw_image,
    record,
    sensor_rig,
    stamp,
    transforms,
    tree,
)

STILL = [(0, "/tf_static", tree()), (0, "/info", info())]


def test_everything_comes_in_the_order_of_its_stamps(tmp_path):
    log = opened(record(tmp_path / "x.mcap"))
    found = [(type(m).__name__, round(m.time - 100, 6)) for m in log.stream()]
    assert found == [("Image", 0.1), ("Cloud", 0.2), ("Cloud", 0.4), ("Image", 0.5)]
    assert [m.time for m in log.stream(["top"], start=100.3)] == [100.4]
    assert [m.time for m in log.stream(end=100.3)] == [100.1, 100.2]
    assert log.notes == ()
    assert log.coverage() == ()
    np.testing.assert_allclose(log.stamps("front"), [100.1, 100.5])


def test_what_was_measured_is_what_was_written(tmp_path):
    image, scan = list(opened(record(tmp_path / "x.mcap")).stream(end=100.3))
    assert isinstance(image, Image)
    assert isinstance(scan, Cloud)
    np.testing.assert_array_equal(image.pixels, IMAGE)
    np.testing.assert_allclose(scan.points, POINTS)
    np.testing.assert_allclose(scan.offset, [0, 0.01, 0.02])
    np.testing.assert_allclose(scan.times - 100, [0.2, 0.21, 0.22])


def test_a_delay_is_taken_off_before_things_are_ordered(tmp_path):
    late = SENSORS.replace('info = "/info"', 'info = "/info"\ndelay = 0.35')
    found = [round(m.time - 100, 6) for m in opened(record(tmp_path / "x.mcap"), late).stream()]
    assert found == [-0.25, 0.15, 0.2, 0.4]


def test_arrival_can_count_instead_of_stamps(tmp_path):
    rig = sensor_rig('[clock]\nstamps = "receive"\n' + SENSORS)
    log = open_sensors(open_log(record(tmp_path / "x.mcap")), rig)
    assert [round(m.time - 100, 6) for m in log.stream()] == [0.25, 0.3, 0.6, 0.7]
    np.testing.assert_allclose(log.stamps("top") - 100, [0.25, 0.6])


def test_mountings_are_joined_along_the_tree_and_against_it(tmp_path):
    log = opened(record(tmp_path / "x.mcap"))
    lidar = log.lidars["top"].body_from_lidar
    np.testing.assert_allclose(lidar @ [1, 0, 0, 1], [1, 1, 2.5, 1], atol=1e-12)  # its x points to the left
    camera = log.cameras["front"].body_from_camera
    # The camera looks ahead and sees the mast 0.25 m before it.
    np.testing.assert_allclose(camera @ [0, 0, 0.25, 1], [1, 0, 2, 1], atol=1e-12)
    np.testing.assert_allclose(camera[:3, 2], [1, 0, 0], atol=1e-12)


def test_calibrations_of_log_and_rig(tmp_path):
    path = record(tmp_path / "x.mcap")
    model = opened(path).cameras["front"].model
    assert (model.width, model.height, model.distortion_model) == (8, 6, "plumb_bob")
    np.testing.assert_allclose(model.matrix, [[5, 0, 3.5], [0, 5, 2.5], [0, 0, 1]])
    np.testing.assert_allclose(model.distortion, [-0.1, 0.01, 0, 0, 0])
    inline = SENSORS.replace('info = "/info"', "[cameras.front.intrinsics]\nwidth = 8\nheight = 6\n")
    inline = inline.replace("height = 6\n", "height = 6\nfocal_length = [7.0, 7.5]\ncentre = [3.0, 2.0]\n")
    np.testing.assert_allclose(opened(path, inline).cameras["front"].model.matrix[0], [7, 0, 3])


def test_a_rectified_right_image_is_taken_from_the_baseline(tmp_path):
    rectified = SENSORS.replace('info = "/info"', 'info = "/info"\nrectified = true')
    path = record(tmp_path / "x.mcap")
    plain, right = (opened(path, sensors).cameras["front"] for sensors in (SENSORS, rectified))
    # P[0, 3] = -fx * baseline, so 2 m: along the camera's x, which is the body's right.
    np.testing.assert_allclose((right.body_from_camera - plain.body_from_camera)[:3, 3], [0, -2, 0], atol=1e-12)
    assert right.model.distortion == ()
    assert right.model.matrix[0, 0] == 4


def test_points_without_echo_too_near_too_far_or_on_the_vehicle_are_dropped(tmp_path):
    xyz = [(np.nan, 0, 0), (0, 0, 0), (0.5, 0, 0), (99, 0, 0), (4, 0, 0), (np.inf, 1, 1), (0, 3, -2.4)]
    rules = "min_range = 1.0\nmax_range = 50.0\nown_body = [[-4, -1, 0], [1, 1, 1]]\n"
    path = record(tmp_path / "x.mcap", [*STILL, (0.1, "/points", cloud(0.1, xyz))])
    sensors = "[lidars" + SENSORS.split("[lidars")[1] + rules
    (scan,) = opened(path, sensors).stream()
    np.testing.assert_allclose(scan.points, [(4, 0, 0)])  # the last one lies in the box, seen from the body
    np.testing.assert_allclose(scan.offset, [0.04])


def test_what_cannot_be_used_is_dropped_and_counted(tmp_path):
    messages = [*STILL]
    messages += [(0.1, "/image", compressed(0.1, IMAGE)), (0.2, "/image", compressed(0.2))]
    messages += [(0.3, "/image", compressed(0.1, IMAGE)), (0.4, "/image", compressed(0.4, IMAGE))]
    messages += [
        (0.1, "/points", cloud(0.1, ())),
        (0.2, "/points", cloud(0.2, [(np.nan,) * 3])),
        (0.3, "/points", cloud(0.3)),
    ]
    log = opened(record(tmp_path / "x.mcap", messages))
    for _ in range(2):  # counted anew each time
        assert [round(m.time - 100, 6) for m in log.stream()] == [0.1, 0.3, 0.4]
        assert log.notes == (
            "front: 1 of 4 images cannot be decoded and were dropped",
            "front: 1 of 4 stamps repeat or go back; those messages were dropped",
            "top: 2 of 3 clouds have no usable point and were dropped",
        )


def test_clouds_with_point_times_of_another_clock_are_dropped_and_that_is_said(tmp_path):
    clock = PointClock("t", "<f8", lambda at, since: at + 5000.0 + since, "s", "epoch")
    filled = ((at, clock.fill(stamp(at) / 1e9, np.ones((50, 3)))) for at in (0.1, 0.2))
    clouds = [(at, "/points", message_from_points(points, stamp(at), "lidar")) for at, points in filled]
    sensors = SENSORS.replace('time_field = "t"\ntime_unit = "ns"\n', clock.rig_lines())
    log = opened(record(tmp_path / "x.mcap", [*STILL, (0.1, "/image", compressed(0.1, IMAGE)), *clouds]), sensors)
    assert not list(log.stream(["top"]))
    assert log.notes == ("top: 2 of 2 clouds have points whose 't' is far from the stamp and were dropped",)


@pytest.mark.parametrize("off", [77.0, -77.0])
def test_one_stamp_that_is_far_off_drops_that_message_alone(tmp_path, off):
    messages = [*STILL, *((t / 10, "/points", cloud(off if t == 3 else t / 10)) for t in range(1, 9))]
    messages += [(t / 10, "/image", compressed(off if t == 5 else t / 10, IMAGE)) for t in range(1, 9)]
    log = opened(record(tmp_path / "x.mcap", messages))
    for name, lost in (("top", 3), ("front", 5)):
        found = [round(10 * (m.time - 100)) for m in log.stream([name])]
        assert found == [t for t in range(1, 9) if t != lost]
        assert f"{name}: 1 of 8 stamps repeat or go back; those messages were dropped" in log.notes


def test_a_clock_that_sorts_sorts_images_and_scans(tmp_path):
    order = [2, 1, 4, 3, 77, 6, 5, 6, 7]
    messages = [*STILL, *((at / 10, "/points", cloud(t / 10)) for at, t in enumerate(order))]
    messages += [(at / 10, "/image", compressed(t / 10, IMAGE)) for at, t in enumerate(order)]
    path = record(tmp_path / "x.mcap", messages)
    log = open_sensors(open_log(path), sensor_rig("[clock]\nsort = true\n" + SENSORS))
    for name in ("top", "front"):
        assert [round(10 * (m.time - 100)) for m in log.stream([name])] == [1, 2, 3, 4, 5, 6, 7, 77]
        assert f"{name}: 1 of 9 stamps repeat or go back; those messages were dropped" in log.notes
    chosen = {"front": np.array([0, 1, 3])}
    assert [round(10 * (m.time - 100)) for m in log.picked(chosen)] == [1, 2, 3]


def test_an_optional_sensor_may_be_missing_and_that_is_said(tmp_path):
    more = SENSORS + '[cameras.rear]\ntopic = "/rear"\ninfo = "/rear/info"\noptional = true\n'
    log = opened(record(tmp_path / "x.mcap"), more)
    assert set(log.cameras) == {"front"}
    assert log.notes == ("no messages of rear: the log is read without",)


def test_late_starts_early_stops_and_pauses_are_told(tmp_path):
    messages = [*STILL, *((t, "/points", cloud(t)) for t in np.arange(0, 9.95, 0.1).tolist() if not 4 < t < 7)]
    messages += [(t, "/image", compressed(t, IMAGE)) for t in np.arange(2.0, 8.05, 0.5).tolist()]
    notes = opened(record(tmp_path / "x.mcap", messages, until=10.0)).coverage()
    assert notes == (
        "front: starts 2.0 s after the poses",
        "front: stops 2.0 s before the poses",
        "top: pauses for 3.0 s, 4.0 s after the poses start",
    )


ONE_IMAGE, ONE_CLOUD = (0.1, "/image", compressed(0.1, IMAGE)), (0.1, "/points", cloud(0.1))
BARE = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
TREE, INFO, BOTH = *STILL, [ONE_IMAGE, ONE_CLOUD]


def frames(parent, turn):
    return 0, "/tf_static", transforms((parent, "camera", (0, 0, 0), turn))


BAD = {
    "no TF": ([INFO, *BOTH], r"no fixed transform joins 'camera' to 'base_link'.*none"),
    "another body": (
        [frames("base", (0, 0, 0, 1)), INFO, *BOTH],
        r"joins 'camera' to 'base_link'.*base, camera; fix fra",
    ),
    "no rotation": (
        [frames("base_link", (0, 0, 0, 0)), INFO, *BOTH],
        r"'base_link' to 'camera' is not rigid; give body_",
    ),
    "no calibration": ([TREE, *BOTH], r"'front': images without calibration: no topic '/info'"),
    "empty calibration": ([TREE, (0, "/info", info(k=np.zeros(9))), *BOTH], r"'/info': the camera is not calibrated"),
    "binning": ([TREE, (0, "/info", info(binning_x=2)), *BOTH], r"binning.*give the intrinsics"),
    "another size": (
        [TREE, (0, "/info", info(16, 12)), *BOTH],
        r"'front' has images of 8x6 pixels, but a calibration for 16x12",
    ),
    "no images": ([*STILL, ONE_CLOUD], r"'front': no messages on topic '/image'.*optional = true"),
    "images of points": (
        [*STILL, (0.1, "/image", cloud(0.1)), ONE_CLOUD],
        r"'/image' is sensor_msgs/msg/PointCloud2, not",
    ),
    "unknown encoding": (
        [*STILL, (0.1, "/image", raw_image(0.1, "yuv411", IMAGE[:, :, :2])), ONE_CLOUD],
        r"'/image' holds images encoded as 'yuv411'.*rgb8",
    ),
    "never decodable": (
        [*STILL, ONE_CLOUD, *((t / 20, "/image", compressed(t / 20)) for t in range(1, 15))],
        r"'front': 10 images cannot be decoded, one after the other",
    ),
    "always empty": (
        [*STILL, ONE_IMAGE, *((t / 20, "/points", cloud(t / 20, ())) for t in range(1, 15))],
        r"'top': 10 clouds have no usable point, one after the other",
    ),
    "no time": (
        [*STILL, ONE_IMAGE, (0.1, "/points", cloud(0.1, dtype=BARE))],
        r"points have no field 't'; they have: x, y",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_ends_in_one_line(tmp_path, case):
    messages, message = BAD[case]
    with pytest.raises(OffpisteError, match=message) as error:
        list(opened(record(tmp_path / "x.mcap", messages)).stream())
    assert "\n" not in str(error.value)


def test_sensors_outside_of_the_poses_are_named(tmp_path):
    path = record(tmp_path / "x.mcap", [*STILL, ONE_CLOUD, (0.2, "/image", compressed(77.0, IMAGE))])
    with pytest.raises(OffpisteError, match=r"'front' has no message from 100\.000 to 101\.000 s"):
        opened(path).coverage()


def test_other_formats_have_no_sensors(tmp_path):
    (tmp_path / "x.csv").write_text("time,x\n0,1\n1,2\n")
    with pytest.raises(OffpisteError, match=r"holds no images or clouds; give a ROS bag .* or a KITTI raw drive"):
        open_sensors(open_log(tmp_path / "x.csv"), sensor_rig())
