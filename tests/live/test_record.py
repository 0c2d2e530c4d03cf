"""Recordings: their files and limits, and their use as logs."""

import threading
import time
from contextlib import closing, contextmanager

import numpy as np
import pytest

from cli.command import run
from live.synthetic_robot import START, Robot, live_settings, odometry, path, planner, small_settings, tree
from offpiste.core.errors import LogError
from offpiste.dataset.store import open_dataset
from offpiste.live import record as recording
from offpiste.live.part import STAMP
from offpiste.live.play import RecordedDrive
from offpiste.live.reception import CourseRequest, Reception
from offpiste.live.record import Recording, record
from offpiste.live.replay import StepDriver, replayed
from offpiste.live.ring import unpacked
from offpiste.live.session import RecordSettings, new_session
from offpiste.logs import open_log
from offpiste.logs.ros.writer import header, make
from offpiste.rig.rig import load_rig
from offpiste.simulation.recorder import stamp_ns, vehicle_messages
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.transport.message_types import MessageTypes
from offpiste.transport.received import Received
from synthetic_drive import samples
from transport.routers import until

TYPES = MessageTypes()


def received(topic, message, seconds):
    data = bytes(TYPES.store.serialize_cdr(message, message.__msgtype__))
    return Received(topic, message.__msgtype__, data, START / 1e9 + seconds)


def recorded(path, rows=500, **settings):
    """Ten seconds of odometry, after transforms and courses that came before the clock was known."""
    with closing(Recording(RecordSettings(path, **settings), TYPES, ("/tf_static", "/course"))) as writer:
        for child in ("lidar", "camera", "lidar"):
            transforms = tree()
            transforms.transforms[0].child_frame_id = child
            writer.add(received("/tf_static", transforms, -np.inf))
        for stamp in (1, 2):
            writer.add(received("/course", make("nav_msgs/Path", header=header(stamp, "map"), poses=[]), -np.inf))
        for row in range(rows):
            writer.add(received("/odom", odometry(row / 50, row / 50), row / 50))
            writer.look()
    return open_log(path)


def test_files_of_limited_duration_are_complete_and_one_drive_together(tmp_path):
    recorded(tmp_path / "drive.mcap", seconds=4.0)
    for name, rows in {"drive": 201, "drive-2": 201, "drive-3": 98}.items():
        log = open_log(tmp_path / f"{name}.mcap")
        assert not log.warnings
        counts = {topic: log.topics[topic].count for topic in ("/odom", "/tf_static", "/course")}
        assert counts == {"/odom": rows, "/tf_static": 2, "/course": 1}
        assert [tf.child for tf in log.transforms(["/tf_static"])] == ["camera", "lidar"]
        assert next(log.messages("/course"))[0] == 2e-9, "the newest"
    stamps = open_log(tmp_path).stamps("/odom")
    np.testing.assert_allclose(stamps, START / 1e9 + np.arange(500) / 50, atol=1e-6)


def test_size_and_repeated_messages_are_limited(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "_LOOKS", 0.0)
    (folder := tmp_path / "a").mkdir()
    recorded(folder / "drive.mcap", size=1e-5)
    assert len(list(folder.iterdir())) >= 2
    assert open_log(folder).topics["/odom"].count == 500
    monkeypatch.setattr(recording, "_MOST", 2)
    log = recorded(tmp_path / "drive.mcap")
    assert {topic: log.topics[topic].count for topic in ("/tf_static", "/course")} == {"/tf_static": 1, "/course": 1}


def test_without_disk_space_the_recording_ends_and_its_file_is_complete(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "_LOOKS", 0.0)
    sizes = iter(range(300, 0, -1))
    monkeypatch.setattr(recording.shutil, "disk_usage", lambda _: type("Usage", (), {"free": next(sizes) * 1e9}))
    with pytest.raises(LogError, match="199 GB of the disk are free, and 200 GB have to stay free"):
        recorded(tmp_path / "drive.mcap", free=200.0)
    log = open_log(tmp_path / "drive.mcap")
    assert log.topics["/odom"].count == 102
    assert not log.warnings


@contextmanager
def running(settings):
    """A session that is recorded."""
    with new_session(settings) as session:
        thread = threading.Thread(target=record, args=(session,))
        thread.start()
        assert until(lambda: status(session).get("state", "").startswith("records"), 20)
        time.sleep(0.5)  # until the routes to its subscriptions exist
        yield session
        for _ in range(2):
            session.ring("end").write(b"end")
        thread.join(20)


def status(session):
    newest = session.ring("status-record").newest()
    return {} if newest is None else unpacked(newest.data)


def test_a_recording_by_the_robots_clock_can_be_replayed(tmp_path, network):
    log, robot = tmp_path / "drive.mcap", Robot(network.session())
    settings = live_settings(tmp_path, network=network, clock="clock", record=RecordSettings(log))
    with running(settings) as session:
        clock, began = session.ring("clock"), time.monotonic()
        for row in range(75):
            now = time.monotonic() - began
            clock.write(STAMP.pack(START / 1e9 + now, time.monotonic()))
            robot.publish(now, 2.0 * now, 2.0)
            time.sleep(max(began + 0.02 * (row + 1) - time.monotonic(), 0.0))
        time.sleep(0.3)
    vehicle = load_rig(settings.rig)
    reception = Reception(vehicle, settings.course, cameras=False)
    drive, driver = RecordedDrive(log, vehicle), StepDriver(vehicle, planner(), reception, small_settings())
    steps = list(replayed(drive, driver, TYPES))
    assert abs(steps[0][0] - START / 1e9) < 10, "by the robot's time, which is not this computer's"
    modes = {step.controls.mode for _, step in steps if step is not None}
    assert "driving" in modes, modes


def test_a_recording_in_several_files_is_inspected_extracted_and_trained_on(tmp_path, network):
    folder, dataset, data = tmp_path / "drive", tmp_path / "a.zarr", samples(60.0)
    course, radius = CourseRequest(topic="/course"), load_vehicle().rolling_radius
    robot, publish = network.session(patient=True), {}
    limits = RecordSettings(folder / "drive.mcap", seconds=22.0)
    settings = live_settings(
        tmp_path, network=network, rig="proving_ground", course=course, clock="clock", record=limits
    )

    def send(topic, message, *, keep=False):
        if topic not in publish:
            publish[topic] = robot.publisher(topic, message.__msgtype__, keep=keep)
        publish[topic](message)

    send("/tf_static", tree(), keep=True)
    send("/course", path("map"), keep=True)
    folder.mkdir()
    with running(settings) as session:
        for sample in data:
            stamp = stamp_ns(sample.time)
            session.ring("clock").write(STAMP.pack(stamp / 1e9, time.monotonic()))
            for topic, message in vehicle_messages(sample, stamp, wheel_radius=radius).items():
                send(topic, message)
            time.sleep(0.001)
        assert until(lambda: status(session)["messages"] >= 6 * len(data) + 6, 20)
        assert not status(session)["dropped"]
    assert {file.name for file in folder.iterdir()} == {"drive.mcap", "drive-2.mcap", "drive-3.mcap"}
    for file in folder.iterdir():
        topics = open_log(file).topics
        assert {*vehicle_messages(data[0], 0, wheel_radius=radius), "/tf_static", "/course"} - {"/gear"} <= set(topics)
        assert topics["/course"].count == topics["/tf_static"].count == 1
    rig, split = ("--rig", "proving_ground"), ("--split", "blocks:0.4,0.3,0.3")
    for command in (
        ("inspect", folder / "drive-2.mcap", *rig),
        ("extract", folder, *rig, "--out", dataset, *split),
        ("train", dataset, "--model", "parametric", "--epochs", "1", "--out", tmp_path / "run"),
    ):
        assert run(*command) == 0, command
    assert len(open_dataset(dataset).drives) == 1, "the files are one drive"
