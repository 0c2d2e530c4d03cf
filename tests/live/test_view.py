"""Viewers of a drive: the newest messages at the viewer's pace, and the viewer's process."""

import os
import signal
import socket
import time
from contextlib import closing, contextmanager
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from live.synthetic_robot import live_settings, plan, reading
from offpiste.live.part import Part
from offpiste.live.ring import pack_fields, pack_layers, pack_plan, packed
from offpiste.live.session import new_session
from offpiste.live.supervisor import Supervisor
from offpiste.live.view import LIFT, Showing, shown_ground, view
from offpiste.live.viewers import VIEWERS, Viewer
from offpiste.logs.measurements import Image
from planning_maps import layers
from runtime.stream import course
from transport.routers import free_port, until


def lines_of(viewer, name):
    """Times and lines of the calls for the course or the plan."""
    return [(at, line) for kind, at, line in (call.args for call in viewer.line.call_args_list) if kind == name]


@contextmanager
def showing(folder, viewer):
    with new_session(live_settings(folder)) as session:
        part = Part("view", session)
        yield part, Showing(part, viewer)


def feed(session, now):
    """Write the values of the other processes; the ground slopes along x."""
    session.ring("readings").write(pack_fields(reading(now, 1.0), control=None))
    session.ring("course").write(pack_fields(course(speed=4.0)))
    session.ring("map").write(pack_layers(layers(plane=(0.5, 0.0)), scan_time=now - 0.2, image_time=np.inf))
    session.ring("plans").write(pack_plan(plan(now), empty=False, stuck=False))
    session.ring("commands").write(packed({"time": now, "applied": np.array((0.4, 0.0, -0.2)), "mode": "driving"}))
    session.ring("images").write(pack_fields(Image(now, "front", np.full((4, 6, 3), 7, np.uint8))))
    status = {"state": "stopping: no plan", "tick_p99_ms": 4.0, "map_age_p99_ms": np.nan, "speed_mps": 1.5}
    session.ring("status-control").write(packed(status))


def test_each_element_of_a_drive_is_shown_on_the_ground(tmp_path):
    viewer, now = Mock(spec=Viewer), time.time()
    with showing(tmp_path, viewer) as (part, shown):
        shown.update()
        assert not viewer.method_calls, "the vehicle's position is still unknown"
        feed(part.session, now)
        shown.update()
    assert viewer.pose.call_args.args[0].position[0] == 1.0
    line = lines_of(viewer, "course")[-1][1].places
    on_map = line[:, 0] <= 20
    np.testing.assert_allclose(line[on_map, 2], 0.5 * line[on_map, 0] + LIFT, atol=0.26)
    np.testing.assert_allclose(line[~on_map, 2], 0.33 + LIFT, err_msg="off the map: the vehicle's height")
    ((_, planned),) = lines_of(viewer, "plan")
    assert planned.places.shape == (50, 3)
    np.testing.assert_allclose(planned.places[:, 0], 1.04 + 0.2 * np.arange(50))
    assert len(np.unique(planned.colours, axis=0)) == 1, "of one speed"
    assert viewer.image.call_args.args[0].pixels.shape == (4, 6, 3)
    viewer.mode.assert_called_once_with(pytest.approx(now, abs=60), "stopping", "no plan")
    numbers = {kind: values for _, kind, values in (call.args for call in viewer.numbers.call_args_list)}
    assert numbers["latencies"] == {"tick_p99_ms": 4.0}, "without NaN"
    assert numbers["command"] == {"throttle": 0.4, "brake": 0.0, "steer": -0.2}
    assert numbers["speed"] == {"speed": 1.5}


def test_known_cells_of_the_map_have_their_values_and_colours():
    known = np.ones((81, 81), bool)
    known[:, :40] = False
    tall = np.zeros((81, 81), np.float32)
    tall[0, 80] = 1.0
    ground = shown_ground(layers(plane=(0.5, 0.0), known=known, obstacle_height=tall), 5.0)
    assert len(ground.places) == 41 * 21, "every second cell of the known half"
    np.testing.assert_allclose(ground.places[:, 2], 0.5 * ground.places[:, 0])
    np.testing.assert_allclose(ground.layers["slope"], 0.5)
    obstacle = ground.layers["obstacle_height"] > 0
    assert ground.places[obstacle, :2].tolist() == [[20.0, -20.0]]
    assert len(np.unique(ground.colours, axis=0)) == 2


def test_a_slow_viewer_is_shown_the_newest_messages(tmp_path, monkeypatch):
    viewer, steady = Mock(spec=Viewer), [0.0]
    monkeypatch.setattr("offpiste.live.view.time", SimpleNamespace(monotonic=lambda: steady[0]))

    def takes_long(_):
        steady[0] += 0.3

    viewer.pose.side_effect = takes_long
    with showing(tmp_path, viewer) as (part, shown):
        for written in range(1, 51):
            feed(part.session, float(written))
            if written % 10 == 0:
                shown.update()
    assert [at for at, _ in lines_of(viewer, "plan")] == [10, 20, 30, 40, 50], "the newest available ones"


def test_a_restarted_viewer_writes_another_file(tmp_path, monkeypatch):
    writer = Mock(return_value=Mock(spec=Viewer, where="there"))
    monkeypatch.setitem(VIEWERS._entries, "writer", writer)
    begun = tmp_path / "drive.rrd"
    for place in (str(begun), "", "127.0.0.1:9876"):
        begun.write_bytes(b"of the killed one")
        with new_session(live_settings(tmp_path, view="writer", view_at=place)) as session:
            session.ring("end").write(b"end")
            view(session)
    assert [call.args[0] for call in writer.call_args_list] == [str(tmp_path / "drive-2.rrd"), "", "127.0.0.1:9876"]
    assert begun.read_bytes() == b"of the killed one"


def test_the_viewers_process_names_a_taken_port_and_is_restarted_if_it_dies(tmp_path, network):
    pytest.importorskip("rerun")
    port = free_port()
    settings = live_settings(tmp_path, network=network, view="rerun", view_at=f"127.0.0.1:{port}")
    with closing(socket.create_server(("127.0.0.1", port))) as taken, new_session(settings) as session:
        supervisor, states = Supervisor(session, network.session(), ("view",)), []

        def comes(begin):
            feed(session, time.time())
            states.append(supervisor.look()["view"][1])
            return states[-1].startswith(begin)

        supervisor.start()
        try:
            said = f"ended with 1 (127.0.0.1:{port}: cannot listen there: Address already in use; "
            assert until(lambda: comes(said), 120), states[-1]
            assert states[-1].endswith("), and is started again")
            taken.close()
            assert until(lambda: comes("shows it in Rerun"), 120), states[-1]
            restarts = supervisor.restarts["view"]
            os.kill(supervisor._processes["view"].pid, signal.SIGKILL)
            assert until(lambda: comes("shows it in Rerun") and supervisor.restarts["view"] == restarts + 1, 120)
        finally:
            supervisor.end()
