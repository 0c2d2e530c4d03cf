"""Columns of MCAP files against the plain reader."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from bag_files import ROS2, START, custom, mcap_file
from offpiste.core.errors import LogError
from offpiste.logs import open_log
from offpiste.logs.ros.bag_files import heard_at
from offpiste.logs.ros.writer import McapWriter, header
from sensor_bags import IMAGE, SECOND, cloud, compressed, joints, odometry, record, stamp


def both(path):
    """Open a file twice, to read it by columns and message by message."""
    quick, plain = open_log(path), open_log(path)
    plain._columns = lambda topic: None
    return quick, plain


def same(quick, plain, topic):
    fields = quick.topics[topic].fields
    for stamps in ("header", "receive"):
        np.testing.assert_array_equal(quick.stamps(topic, stamps=stamps), plain.stamps(topic, stamps=stamps))
        if fields:
            one, other = (log.read(topic, fields, stamps=stamps) for log in (quick, plain))
            np.testing.assert_array_equal(one.time, other.time)
            np.testing.assert_array_equal(one.values, other.values)


@pytest.mark.parametrize("seed", range(3))
def test_columns_are_what_the_plain_reader_gives(tmp_path, seed):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0, 0.3, 40))
    messages = [(t, "/joints", joints(t - 0.01, rng.standard_normal(3))) for t in times.tolist()]
    messages += [(t, "/image", compressed(t - 0.1, IMAGE)) for t in times[::4].tolist()]
    messages += [(t, "/changing", joints(t, rng.standard_normal(1 + k % 3))) for k, t in enumerate(times.tolist())]
    messages += [(t, "/names", joints(t, [1.0], ("x" * (1 + k % 3),))) for k, t in enumerate(times.tolist())]
    quick, plain = both(record(tmp_path / "log.mcap", messages))
    for topic in quick.topics:
        same(quick, plain, topic)
    assert quick._columns(quick.topics["/joints"])[0].fields == ("position[0]", "position[1]", "position[2]")
    assert quick._columns(quick.topics["/changing"])[0].fields == ()


def test_messages_that_arrive_out_of_order_across_chunks(tmp_path):
    path = tmp_path / "log.mcap"
    order = np.random.default_rng(1).permutation(60)
    with McapWriter(path) as writer:
        for k in order.tolist():
            writer.write("/odom", odometry(k / 10), stamp(k / 5))
    quick, plain = both(path)
    same(quick, plain, "/odom")
    assert (np.diff(quick.stamps("/odom", stamps="receive")) > 0).all()


def test_damage_is_left_to_the_plain_reader(tmp_path):
    path = record(tmp_path / "log.mcap")
    data = bytearray(path.read_bytes())
    data[len(data) // 4] ^= 0xFF
    path.write_bytes(data)
    quick, plain = both(path)
    outcomes = []
    for log in (quick, plain):
        try:
            outcomes.append(log.read("/odom", ["pose.pose.position.x"]).values.tolist())
        except LogError as error:
            outcomes.append(str(error))
    assert outcomes[0] == outcomes[1]


def test_picked_clouds_and_images_are_those_of_the_stream(tmp_path):
    times = np.arange(0.1, 3, 0.1).tolist()
    messages = [(t + 0.05, "/points", cloud(t)) for t in times] + [
        (t + 0.1, "/image", compressed(t, IMAGE)) for t in times
    ]
    log, plain = both(record(tmp_path / "log.mcap", messages))
    wanted = log.stamps("/points")[[3, 4, 17]]
    for one in (log, plain):
        assert [cloud.time for cloud in one.clouds("/points", times=wanted)] == wanted.tolist()
        assert [image.time for image in one.images("/image", times=log.stamps("/image")[[0, 28]])] == [
            100 * SECOND / SECOND + 0.1,
            log.stamps("/image")[28],
        ]
    all_images = {image.time: image.pixels for image in log.images("/image")}
    (image,) = log.images("/image", times=log.stamps("/image")[[5]])
    np.testing.assert_array_equal(image.pixels, all_images[image.time])


@pytest.mark.parametrize("fields", [["stamp", "angle"], ["angle", "stamp"], ["stamp", "angle", "header"]])
def test_a_stamp_beside_the_numbers_counts_where_there_is_no_header(tmp_path, fields):
    kinds = {"stamp": "builtin_interfaces/Time", "angle": "float32", "header": "std_msgs/Header"}
    time = ROS2.types["builtin_interfaces/msg/Time"]
    rows = [{"stamp": time(START + k - 5, 0), "angle": float(k)} for k in range(20)]
    rows[7]["stamp"] = time(0, 0)
    if headed := "header" in fields:
        rows = [row | {"header": header((START + 60 + k) * SECOND, "base")} for k, row in enumerate(rows)]
    store, name, messages = custom("".join(f"{kinds[one]} {one}\n" for one in fields), rows)
    quick, plain = both(mcap_file(tmp_path / "log.mcap", messages, msgtype=name, store=store))
    same(quick, plain, "/odom")
    expected = [START + k + (60 if headed else -5 if k != 7 else 0) for k in range(20)]
    np.testing.assert_array_equal(plain.stamps("/odom"), expected)
    assert heard_at(5.0, messages[3], "header") == expected[3]
    assert heard_at(5.0, messages[3], "receive") == 5.0
    no_time = SimpleNamespace(header=SimpleNamespace(stamp=1.5))
    assert math.isnan(heard_at(5.0, no_time, "header"))
    assert heard_at(5.0, no_time, "receive") == 5.0
    assert heard_at(-math.inf, SimpleNamespace(), "header") == -math.inf


def test_a_number_that_is_called_stamp_is_no_time(tmp_path):
    store, name, messages = custom("uint64 stamp\nfloat32 angle\n", [{"stamp": k, "angle": 0.5} for k in range(20)])
    quick, plain = both(mcap_file(tmp_path / "log.mcap", messages, msgtype=name, store=store))
    same(quick, plain, "/odom")
    np.testing.assert_array_equal(plain.stamps("/odom"), START + np.arange(20))


def test_a_header_of_zero_gives_way_to_the_arrival(tmp_path):
    message = odometry(0.0)
    message.header.stamp.sec = message.header.stamp.nanosec = 0
    quick, plain = both(record(tmp_path / "log.mcap", [(0.5, "/unstamped", message)]))
    same(quick, plain, "/unstamped")
    assert quick.stamps("/unstamped").tolist() == [100.5]
