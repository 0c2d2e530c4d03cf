"""The process that records: what it writes can be replayed, whatever clock the robot has."""

import subprocess
import sys
import threading
import time
from contextlib import closing, contextmanager
from dataclasses import replace

import numpy as np
import pytest

from live.made_up_robot import START, cloud, odometry, planner, small_settings, tree, write_course, write_rig
from live.test_reception import path
from live.test_supervisor import RUN
from offpiste.cli import main
from offpiste.dataset.store import open_dataset
from offpiste.live.driver import StepDriver
from offpiste.live.log_steps import RecordedDrive, replayed
from offpiste.live.packing import unpacked
from offpiste.live.part import STAMP
from offpiste.live.parts.record import record
from offpiste.live.reception import CourseRequest, Reception
from offpiste.live.session import LiveSettings, RecordSettings, new_session
from offpiste.logs import open_log
from offpiste.rig.rig import load_rig
from offpiste.simulation.recorder import stamp_ns, vehicle_messages
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.transport.message_types import MessageTypes
from offpiste.transport.zenoh_transport import ZenohSettings
from synthetic_drive import samples
from transport.routers import Network, until


@contextmanager
def recording(settings, log, **limits):
    """A session that is recorded, whatever its other settings are."""
    with new_session(replace(settings, record=RecordSettings(log, **limits))) as session:
        thread = threading.Thread(target=record, args=(session,))
        thread.start()
        assert until(lambda: said(session, "records"), 20)
        time.sleep(0.5)  # routes to its subscriptions are set up
        yield session
        for _ in range(2):
            session.ring("end").write(b"end")
        thread.join(20)


def said(session, words):
    """The last status of the recording, once it says these words."""
    newest = session.ring("status-record").newest()
    values = {} if newest is None else unpacked(newest.data)
    return values if words in values.get("state", "") else None


def test_what_was_recorded_by_the_robots_clock_can_be_replayed(tmp_path):
    rig, log, request = write_rig(tmp_path), tmp_path / "drive.mcap", CourseRequest(write_course(tmp_path))
    with closing(Network()) as network:
        robot, settings = network.session(), ZenohSettings(endpoint=network.endpoint)
        settings = LiveSettings(rig, RUN, None, request, small_settings(), settings, clock="clock")
        with recording(settings, log) as session:
            odom = robot.publisher("/odom", "nav_msgs/msg/Odometry")
            points = robot.publisher("/points", "sensor_msgs/msg/PointCloud2")
            robot.publisher("/tf_static", "tf2_msgs/msg/TFMessage", keep=True)(tree())
            clock, began = session.ring("clock"), time.monotonic()
            for row in range(100):
                now = time.monotonic() - began
                clock.write(STAMP.pack(START / 1e9 + now, time.monotonic()))
                odom(odometry(now, 2.0 * now, 2.0))
                if row % 5 == 0:
                    points(cloud(now - 0.1))
                time.sleep(max(began + 0.02 * (row + 1) - time.monotonic(), 0.0))
            time.sleep(0.3)
    vehicle = load_rig(rig)
    reception = Reception(vehicle, request, cameras=False)
    drive, driver = RecordedDrive(log, vehicle), StepDriver(vehicle, planner(), reception, small_settings())
    steps = list(replayed(drive, driver, MessageTypes()))
    assert abs(steps[0][0] - START / 1e9) < 10, "by the robot's time, which is not this computer's"
    modes = [step.controls.mode for _, step in steps if step is not None]
    assert "driving" in modes, set(modes)
    assert np.isfinite(driver.runtime.follower.speed)


def test_a_recording_in_several_files_is_inspected_extracted_and_trained_on(tmp_path):
    folder, dataset, data = tmp_path / "drive", str(tmp_path / "a.zarr"), samples(60.0)
    request, radius = CourseRequest(topic="/course"), load_vehicle().rolling_radius
    with closing(Network()) as network:
        robot, where = network.session(patient=True), ZenohSettings(endpoint=network.endpoint)
        settings = LiveSettings("proving_ground", RUN, None, request, small_settings(), where, clock="clock")
        publish = {}

        def send(topic, message, *, keep=False):
            if topic not in publish:
                publish[topic] = robot.publisher(topic, message.__msgtype__, keep=keep)
            publish[topic](message)

        send("/tf_static", tree(), keep=True)
        send("/course", path("map"), keep=True)
        with recording(settings, folder / "drive.mcap", seconds=22.0) as session:
            for sample in data:
                stamp = stamp_ns(sample.time)
                session.ring("clock").write(STAMP.pack(stamp / 1e9, time.monotonic()))
                for topic, message in vehicle_messages(sample, stamp, wheel_radius=radius).items():
                    send(topic, message)
                time.sleep(0.002)
            assert until(lambda: said(session, "records")["messages"] >= 6 * len(data) + 6, 20)
            assert not said(session, "records")["dropped"]
    assert {file.name for file in folder.iterdir()} == {"drive.mcap", "drive-2.mcap", "drive-3.mcap"}
    for file in folder.iterdir():
        topics = open_log(file).topics
        assert {*vehicle_messages(data[0], 0, wheel_radius=radius), "/tf_static", "/course"} - {"/gear"} <= set(topics)
        assert topics["/course"].count == topics["/tf_static"].count == 1
    rig, split = ("--rig", "proving_ground"), ("--split", "blocks:0.4,0.3,0.3")
    ends_well("inspect", str(folder), *rig)
    ends_well("inspect", str(folder / "drive-2.mcap"), *rig)
    ends_well("extract", str(folder), *rig, "--out", dataset, *split)
    assert len(open_dataset(dataset).drives) == 1, "the files are one drive"
    ends_well("train", dataset, "--model", "parametric", "--epochs", "1", "--out", str(tmp_path / "run"))


def ends_well(*command):
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert not ended.value.code, command


def test_where_the_disk_has_too_little_space_recording_ends_and_says_so(tmp_path):
    with closing(Network()) as network:
        settings = ZenohSettings(endpoint=network.endpoint)
        request = CourseRequest(write_course(tmp_path))
        settings = LiveSettings(write_rig(tmp_path), RUN, None, request, small_settings(), settings)
        with new_session(replace(settings, record=RecordSettings(tmp_path / "a.mcap", free=1e6))) as session:
            record(session)
            assert "GB of the disk are free, and 1e+06 GB have to stay free" in said(session, "")["state"]
    assert not open_log(tmp_path / "a.mcap").topics


@pytest.mark.parametrize(
    ("name", "options", "what"),
    [
        ("a.mcap", ("--record-free", "1e6"), "have to stay free; make room on the disk, or lower --record-free"),
        ("a.mcap", ("--record-free", "nan"), "--record-free nan"),
        ("a.mcap", ("--record-size", "0"), "--record-size 0"),
        ("a.mcap", ("--record-seconds", "-5"), "--record-seconds -5"),
        ("", ("--record-free", "3"), "nothing is recorded; give --record, too"),
        ("", ("--record-size", "3"), "nothing is recorded; give --record, too"),
        ("", ("--record-seconds", "3"), "nothing is recorded; give --record, too"),
        ("file.mcap", (), "exists already"),
        ("file.mcap/a.mcap", (), "cannot be written"),
        ("a.csv", (), "ending .mcap"),
    ],
)
def test_a_recording_that_could_not_be_made_is_refused_before_anything_starts(tmp_path, capsys, name, options, what):
    (tmp_path / "file.mcap").write_text("x")
    command = ["live", write_rig(tmp_path), "--run", RUN, "--course", str(write_course(tmp_path)), *options]
    with pytest.raises(SystemExit) as ended:
        main(command + ["--record", str(tmp_path / name)] * bool(name))
    assert ended.value.code == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert what in line
    assert (tmp_path / "file.mcap").read_text() == "x"
    assert not (tmp_path / "a.mcap").exists()


def test_a_drive_whose_recording_ends_for_want_of_space_ends_well(tmp_path):
    """The space is there when the command looks, and gone when the recording begins."""
    with closing(Network()) as network:
        options = ["--run", RUN, "--course", str(write_course(tmp_path)), "--endpoint", network.endpoint]
        options += ["--record", str(tmp_path / "a.mcap"), "--record-free", "1e6", "--seconds", "20"]
        code = "import offpiste.live.commands as c; c.refuse_full_disk = print; from offpiste.cli import main; main()"
        live = [sys.executable, "-c", code, "live", write_rig(tmp_path, actuators=True), *options]
        ended = subprocess.run(live, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 0, ended.stderr
    assert "record: ended: " in ended.stdout
    assert "and 1e+06 GB have to stay free" in ended.stdout
    assert not open_log(tmp_path / "a.mcap").topics
