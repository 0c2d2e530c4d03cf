"""Stamps, repeats and the vehicle's own body, in small recordings."""

from dataclasses import replace

import numpy as np

import textured_world as world
from offpiste.inspection.sensor_samples import Grey, driving, pairs
from offpiste.inspection.sensor_stamps import check_repeated_images, check_sensor_stamps, untimed_points
from offpiste.inspection.sensors import check_sensors
from offpiste.logs import open_log
from sensor_bags import IMAGE, SENSORS, cloud, compressed, info, opened, record, sensor_rig, tree

FIXED = [(0, "/tf_static", tree()), (0, "/info", info())]


def stamped(tmp_path, *, image=lambda t: t, arrival=lambda t: t, until=20.0, last=np.inf):
    """Findings about a drive of two images and clouds a second; the images' stamps and arrivals as given."""
    times = np.arange(0.2, until, 0.5).tolist()
    messages = [(t + 0.05, "/points", cloud(t)) for t in times]
    messages += [(arrival(t) + 0.05, "/image", compressed(image(t), IMAGE)) for t in times if t < last]
    path = record(tmp_path / f"{last}.mcap", messages + FIXED, until=until)
    return [(f.severity, f.where, f.what) for f in check_sensor_stamps(open_log(path), opened(path))]


def test_even_stamps_are_right(tmp_path):
    assert stamped(tmp_path) == []


def test_images_of_one_stamp_are_no_copies(tmp_path):
    times = np.arange(0.2, 20.0, 0.5).tolist()
    messages = [(t + 0.05, "/points", cloud(t)) for t in times]
    messages += [(t + 0.05, "/image", compressed(np.floor(t), IMAGE)) for t in times]
    path = record(tmp_path / "seconds.mcap", messages + FIXED, until=20.0)
    (found,) = [f for f in check_sensor_stamps(open_log(path), opened(path)) if f.what == "stamps repeat"]
    assert found.severity == "warning"
    assert "copies" not in found.remedy


def test_a_camera_that_stops_early(tmp_path):
    assert stamped(tmp_path, last=15.0) == [("note", "/image", "starts late or stops early")]
    assert stamped(tmp_path, last=8.0) == [("warning", "/image", "starts late or stops early")]


def test_a_camera_that_pauses(tmp_path):
    assert ("warning", "/image", "has a gap") in stamped(tmp_path, image=lambda t: t if t < 10 else t + 6, until=30)


def test_a_clock_that_drifts(tmp_path):
    found = stamped(tmp_path, image=lambda t: t * 0.99, until=40)
    assert ("warning", "/image", "its clock drifts") in found


def test_a_driver_that_repeats_images():
    pictures = [Grey(float(i), np.full((4, 4), i, np.uint8)) for i in range(20)]
    assert check_repeated_images("front", pictures) == []
    again = [replace(p, pixels=pictures[i // 3 * 3].pixels) for i, p in enumerate(pictures)]
    (finding,) = check_repeated_images("front", again)
    assert finding.evidence == "13 of 19 images are those before them, bit for bit"


def test_pairs_are_half_a_second_apart():
    assert list(pairs([0.0, 0.5, 2.0, 2.45, 4.0, 9.0])) == [(0, 1), (2, 3)]
    assert list(pairs([0.0, 0.25, 0.5, 0.75, 1.1])) == [(0, 2), (1, 3), (2, 4), (3, 4)]


def test_driving_starts_where_the_vehicle_moves():
    assert driving(world.poses()) == (0.0, world.poses().span[1])


def test_a_calibration_of_another_size_is_reported_and_stops_nothing(tmp_path):
    messages = [(0.3, "/points", cloud(0.2)), (0.3, "/image", compressed(0.1, np.zeros((60, 80, 3), np.uint8))), *FIXED]
    path = record(tmp_path / "drive.mcap", messages)
    (finding,) = [f for f in check_sensors(open_log(path), sensor_rig()) if f.severity == "warning"]
    assert "images of 80x60, and a calibration for 8x6" in finding.what
    assert "calibration of these images" in finding.remedy


def test_without_sensors_there_are_no_findings(tmp_path):
    path = record(tmp_path / "drive.mcap")
    assert check_sensors(open_log(path), sensor_rig("")) == []
    optional = sensor_rig('[lidars.top]\ntopic = "/none"\noptional = true\n')
    assert check_sensors(open_log(path), optional) == []
    (finding,) = check_sensors(open_log(path), sensor_rig('[lidars.top]\ntopic = "/none"\n'))
    assert finding.severity == "warning"
    assert "no messages on topic '/none'" in finding.what


def test_points_with_times_that_the_rig_does_not_name(tmp_path):
    path = record(tmp_path / "drive.mcap")
    assert untimed_points(opened(path)) == {}
    (lines,) = untimed_points(opened(path, SENSORS.partition("time_field")[0])).values()
    assert lines == 'lidars.top.time_field = "t"; lidars.top.time_unit = "ns"; lidars.top.time_origin = "stamp"'


def stamped_as(tmp_path, *, image=lambda t: t, cloud_stamp=lambda t: t, every=0.5, until=20.0, sensors=SENSORS):
    """Findings about sensors whose messages arrive in order, stamped as given; the vehicle is right."""
    times = np.arange(0.2, until, every).tolist()
    messages = [(t + 0.05, "/points", cloud(cloud_stamp(t))) for t in times]
    messages += [(t + 0.05, "/image", compressed(image(t), IMAGE)) for t in times]
    path = record(tmp_path / f"{len(sensors)}.mcap", messages + FIXED, until=until)
    return check_sensor_stamps(open_log(path), opened(path, sensors))


def test_what_is_wrong_with_a_sensor_spoils_no_channel_and_edits_no_clock(tmp_path):
    shuffled = np.random.default_rng(0).permutation(np.arange(0.2, 20.0, 0.5))
    found = stamped_as(tmp_path, image=lambda t: shuffled[round(2 * (t - 0.2))])
    assert [(f.severity, f.where, f.what) for f in found] == [
        ("warning", "/image", "samples are not in the order of their stamps")
    ]
    assert found[0].cures == ()
    assert "are dropped on reading" in found[0].remedy


def test_a_sensor_that_is_slow_on_purpose_is_right(tmp_path):
    assert stamped_as(tmp_path, every=8.0, until=193.0) == []


def test_a_sensor_by_another_clock_is_given_the_delay_that_puts_it_right(tmp_path):
    (found,) = stamped_as(tmp_path, image=lambda t: t - 30.0)
    assert (found.severity, found.where) == ("warning", "/image")
    assert found.remedy.startswith("cameras.front.delay = -30.05, ")  # by its arrival
    assert found.cures == ()  # it may as well be sent late
    cured = SENSORS.replace('info = "/info"', 'info = "/info"\ndelay = -30.05')
    assert stamped_as(tmp_path, image=lambda t: t - 30.0, sensors=cured) == []
