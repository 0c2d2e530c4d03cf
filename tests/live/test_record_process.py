"""The process that records: what it writes can be replayed, whatever clock the robot has."""

import threading
import time
from contextlib import closing

import numpy as np

from live.made_up_robot import START, cloud, odometry, planner, small_settings, tree, write_course, write_rig
from live.test_supervisor import RUN
from offpiste.live.driver import StepDriver
from offpiste.live.log_steps import RecordedDrive, replayed
from offpiste.live.part import STAMP
from offpiste.live.parts.record import record
from offpiste.live.reception import CourseRequest, Reception
from offpiste.live.session import LiveSettings, new_session
from offpiste.rig.rig import load_rig
from offpiste.transport.message_types import MessageTypes
from offpiste.transport.zenoh_transport import ZenohSettings
from transport.routers import Network, until


def test_what_was_recorded_by_the_robots_clock_can_be_replayed(tmp_path):
    rig, log, request = write_rig(tmp_path), tmp_path / "drive.mcap", CourseRequest(write_course(tmp_path))
    with closing(Network()) as network:
        robot, settings = network.session(), ZenohSettings(endpoint=network.endpoint)
        settings = LiveSettings(rig, RUN, None, request, small_settings(), settings, clock="clock", record=log)
        with new_session(settings) as session:
            recording = threading.Thread(target=record, args=(session,), kwargs={"cameras": False})
            recording.start()
            odom = robot.publisher("/odom", "nav_msgs/msg/Odometry")
            points = robot.publisher("/points", "sensor_msgs/msg/PointCloud2")
            robot.publisher("/tf_static", "tf2_msgs/msg/TFMessage", keep=True)(tree())
            assert until(log.exists, 20)
            time.sleep(0.5)
            clock, began = session.ring("clock"), time.monotonic()
            for row in range(100):
                now = time.monotonic() - began
                clock.write(STAMP.pack(START / 1e9 + now, time.monotonic()))
                odom(odometry(now, 2.0 * now, 2.0))
                if row % 5 == 0:
                    points(cloud(now - 0.1))
                time.sleep(max(began + 0.02 * (row + 1) - time.monotonic(), 0.0))
            time.sleep(0.3)
            for _ in range(2):
                session.ring("end").write(b"end")
            recording.join(20)
    vehicle = load_rig(rig)
    reception = Reception(vehicle, request, cameras=False)
    drive, driver = RecordedDrive(log, vehicle), StepDriver(vehicle, planner(), reception, small_settings())
    steps = list(replayed(drive, driver, MessageTypes()))
    assert abs(steps[0][0] - START / 1e9) < 10, "by the robot's time, which is not this computer's"
    modes = [step.controls.mode for _, step in steps if step is not None]
    assert "driving" in modes, set(modes)
    assert np.isfinite(driver.runtime.follower.speed)
