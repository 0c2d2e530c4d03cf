"""What is published about a drive lies on the map's ground, in the frame of the vehicle's poses."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import torch

from live.made_up_robot import write_course, write_rig
from live.test_plan_process import LAYERS
from live.test_supervisor import RUN
from offpiste.live.packing import pack_layers, pack_plan
from offpiste.live.reception import CourseRequest
from offpiste.live.reports import MAP, PLAN, path_message
from offpiste.live.session import LiveSettings, new_session
from offpiste.live.supervisor import Supervisor
from offpiste.runtime.follower import TimedPlan
from offpiste.runtime.prediction import Prediction
from transport.routers import Network

AHEAD = np.zeros((20, 6))
AHEAD[:, 0] = np.linspace(0.0, 3.8, 20)


def test_a_plan_lies_on_the_ground_as_far_as_it_is_known():
    height = np.tile((0.0, 1.0, 3.0, np.nan), (3, 1))
    poses = path_message(Prediction(1.0, AHEAD), 0, "odom", replace(LAYERS, elevation=height)).poses
    places = [(round(pose.pose.position.x, 6), pose.pose.position.z) for pose in poses]
    assert places == [(0.0, 0.0), (1.0, 3.0), (2.0, 3.0), (3.0, 3.0)], "beyond the map as at its end"
    assert {pose.header.frame_id for pose in poses} == {"odom"}
    assert path_message(Prediction(1.0, AHEAD), 0, "odom", None).poses[-1].pose.position.z == 0.0


def test_plan_and_map_are_published_in_the_frame_of_the_poses(tmp_path):
    heard = []
    with closing(Network()) as network:
        settings = LiveSettings(write_rig(tmp_path), RUN, None, CourseRequest(write_course(tmp_path)))
        transport = network.session()
        transport.publisher = lambda topic, *_, **__: lambda message: heard.append((topic, message))
        with new_session(settings) as session:
            supervisor = Supervisor(session, transport, cameras=False, names=())
            for numbers in ({"frame": "odom"}, {"frame": ""}):
                session.ring("map").write(pack_layers(LAYERS, scan_time=1.0))
                plan = TimedPlan(1.0, 1.0, torch.zeros(20, 3))
                session.ring("plans").write(pack_plan(plan, Prediction(1.0, AHEAD), empty=False, stuck=False))
                supervisor.report({"receive": (0, "ready", numbers)})
    frames = [message.header.frame_id for topic, message in heard if topic in (PLAN, MAP)]
    assert frames == ["odom", "odom", "map", "map"]
