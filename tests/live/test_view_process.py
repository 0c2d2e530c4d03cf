"""The viewer's process: it shows what others hand over, holds nobody up when it hangs, and is started again."""

import os
import signal
import socket
import time
from contextlib import closing

import pytest

from live.made_up_robot import write_course, write_rig
from live.test_foxglove import App
from live.test_view import RUN, feed
from offpiste.live.reception import CourseRequest
from offpiste.live.session import LiveSettings, ViewSettings, new_session
from offpiste.live.supervisor import Supervisor
from offpiste.transport.zenoh_transport import ZenohSettings
from transport.routers import Network, free_port, until

pytest.importorskip("foxglove")


class Drive:
    """The process that shows, and a test that hands over what the others would."""

    def __init__(self, folder, port=0):
        self.network, self.port = Network(), port or free_port()
        course, place = CourseRequest(write_course(folder)), f"127.0.0.1:{self.port}"
        robot, view = ZenohSettings(endpoint=self.network.endpoint), ViewSettings("foxglove", place)
        self._new = new_session(LiveSettings(write_rig(folder), RUN, None, course, robot=robot, view=view))
        self.session = self._new.__enter__()
        self.supervisor = Supervisor(self.session, self.network.session(), cameras=False, names=("view",))
        self.supervisor.start()

    def run(self, seconds):
        """Hand over at 50 Hz."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            feed(self.session, time.time())
            time.sleep(0.02)

    def state(self):
        return self.supervisor.look()["view"]

    def shows(self, seconds=120.0):
        return until(lambda: (self.run(0.1), self.state()[1].startswith("shows it in Foxglove"))[1], seconds)

    def close(self):
        self.supervisor.end()
        self._new.__exit__(None, None, None)
        self.network.close()


def test_a_drive_is_shown_by_a_process_that_holds_nobody_up_and_is_started_again(tmp_path):
    with closing(Drive(tmp_path)) as drive:
        assert drive.shows(), drive.state()
        app = App(drive.port)
        app.subscribe("/plan", "/map")
        drive.run(1.0)
        got = app.received(2)
        assert len(got["/plan"][1].entities[0].lines[0].points) == 50
        assert got["/map"][1].point_stride > 0
        app.close()
        pid = drive.supervisor._processes["view"].pid
        os.kill(pid, signal.SIGSTOP)
        drive.run(2.0)
        assert drive.state()[1] == "gives no sign of life"
        os.kill(pid, signal.SIGKILL)
        assert until(lambda: drive.supervisor.look() and drive.supervisor.restarts["view"] == 1, 10)
        assert drive.shows(), drive.state()


def test_a_taken_port_is_said_as_the_reason(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken, closing(Drive(tmp_path, taken.getsockname()[1])) as drive:
        said = f"ended with 1 (127.0.0.1:{drive.port}: cannot listen there: Address already in use; "
        states = []
        assert until(lambda: (states.append(drive.state()[1]), states[-1].startswith(said))[1], 120), states[-1]
        assert states[-1].endswith("), and is started again")
