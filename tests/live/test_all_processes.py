"""A whole drive: a made-up robot on the transport, all processes, and each of them killed while it drives."""

import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import pytest

from live.made_up_robot import START, cloud, odometry, small_settings, tree, write_course, write_rig
from live.test_service_manager import listening
from offpiste.live.log_steps import RecordedDrive
from offpiste.live.part import AFTER
from offpiste.live.reception import CourseRequest
from offpiste.live.session import LiveSettings, RecordSettings, new_session
from offpiste.live.supervisor import Supervisor
from offpiste.logs import open_log
from offpiste.transport.zenoh_transport import ZenohSettings
from transport.routers import Network, free_port, until

RUN = "pretrained:proving-ground/parametric"


class Robot:
    """Stands on a plain, and publishes in real time."""

    def __init__(self, network):
        session = self.session = network.session()
        self.odom = session.publisher("/odom", "nav_msgs/msg/Odometry")
        self.points = session.publisher("/points", "sensor_msgs/msg/PointCloud2")
        session.publisher("/tf_static", "tf2_msgs/msg/TFMessage", keep=True)(tree())
        self.commands, self.rows = [], 0
        session.subscribe("/drive", lambda m: self.commands.append((time.monotonic(), session.decode(m).drive)))

    def publish(self):
        now = time.time() - START / 1e9
        self.odom(odometry(now, 1.0))
        if self.rows % 5 == 0:
            self.points(cloud(now - 0.1))
        self.rows += 1


class Live:
    def __init__(self, folder):
        self.network = Network()
        self.robot = Robot(self.network)
        self.log = folder / "drive.mcap"
        settings = LiveSettings(
            write_rig(folder, actuators=True), RUN, None, CourseRequest(write_course(folder)), small_settings(),
            ZenohSettings(endpoint=self.network.endpoint), drive=True, record=RecordSettings(self.log),
        )  # fmt: skip
        self._new = new_session(settings)
        self.supervisor = Supervisor(self._new.__enter__(), self.network.session(), cameras=False)
        self.supervisor.start()
        self.parts = {}

    def run(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.robot.publish()
            self.parts = self.supervisor.look()
            time.sleep(0.02)

    def comes_to_drive(self, seconds):
        """Whether throttle is commanded within some time."""
        seen, end = len(self.robot.commands), time.monotonic() + seconds
        while time.monotonic() < end:
            self.run(0.1)
            if any(drive.acceleration > 0 for _, drive in self.robot.commands[seen:]):
                return True
        return False

    def is_back(self, name, seconds):
        """Whether a process is ready again within some time, once started again."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.run(0.1)
            if (self.parts[name][1], self.supervisor.restarts[name]) == ("ready", 1):
                return True
        return False

    def states(self):
        return {name: (state, dict(numbers).get("dropped")) for name, (_, state, numbers) in self.parts.items()}

    def close(self):
        self.supervisor.end()
        self._new.__exit__(None, None, None)
        self.network.close()


def test_a_drive_with_every_process_killed_once(tmp_path):
    with closing(Live(tmp_path)) as live:
        assert live.comes_to_drive(120), live.states()
        live.run(0.5)
        live.supervisor.report(live.parts)
        for name in ("receive", "map", "plan"):
            moment = time.monotonic()
            os.kill(live.supervisor._processes[name].pid, signal.SIGKILL)
            live.run(0.3)
            times = [moment, *(at for at, _ in live.robot.commands if at > moment)]
            assert max(later - at for at, later in pairwise(times)) < 0.2, f"commands flow without {name}"
            assert live.is_back(name, 60), live.states()
            assert live.comes_to_drive(20), (name, live.states())
        assert live.parts["record"][1].startswith("records")
    log = open_log(live.log)
    assert {"/odom", "/points", "/tf_static", "/drive", "/offpiste/mode"} <= set(log.topics)
    assert not log.warnings
    assert any(one.topic == "/points" for step in RecordedDrive(live.log).steps() for one in step.messages)


@pytest.mark.parametrize("router", [False, True])
def test_processes_end_when_their_supervisor_is_killed(tmp_path, router):
    said = tmp_path / "said.txt"
    with closing(Network()) as network, said.open("w") as file:
        endpoint = ["--endpoint", f"tcp/127.0.0.1:{free_port()}" if router else network.endpoint]
        where = ["--router", *endpoint] if router else endpoint
        command = [sys.executable, "-m", "offpiste", "live", write_rig(tmp_path, actuators=True), "--run", RUN,
                   *where, "--course", str(write_course(tmp_path)), "--drive"]  # fmt: skip
        live = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT)
        assert until(lambda: "watchdog: ready" in said.read_text(), 60), said.read_text()
        children = _descendants(live.pid)
        assert len(children) >= 5
        live.send_signal(signal.SIGKILL)
        live.wait()
        assert until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in children), 30)
        assert not list(Path("/dev/shm").glob(f"offpiste-live-{live.pid}-*"))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT, signal.SIGTSTP])
def test_a_signal_to_all_processes_at_once_is_an_orderly_end(tmp_path, number):
    said, notified = tmp_path / "said.txt", str(tmp_path / "notify")
    with closing(Network()) as network, said.open("w") as file, listening(notified) as heard:
        options = ["--run", RUN, "--endpoint", network.endpoint, "--course", str(write_course(tmp_path)), "--drive"]
        heeding = ["env", "--default-signal=HUP,INT"]  # also where the tests run under nohup
        command = [*heeding, sys.executable, "-m", "offpiste", "live", write_rig(tmp_path, actuators=True), *options]
        environment = os.environ | {"NOTIFY_SOCKET": notified}
        live = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, start_new_session=True, env=environment)
        assert until(lambda: "watchdog: ready" in said.read_text(), 60), said.read_text()
        children = _descendants(live.pid)
        os.killpg(live.pid, number)
        assert live.wait(30) == 0, said.read_text()
        assert until(lambda: not any(runs(pid) for pid in children), AFTER + 5)
        assert not list(Path("/dev/shm").glob(f"offpiste-live-{live.pid}-*"))
        assert "Traceback" not in said.read_text()
    assert [next(iter(heard[k][1])) for k in (0, 1, -1)] == ["READY", "WATCHDOG", "STOPPING"]


def runs(pid):
    """Whether a process runs: one that has ended and was not waited for does not."""
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z"


def _descendants(pid):
    found, border = [], [pid]
    while border:
        parent = border.pop()
        new = [int(child) for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]
        border += new
        found += new
    return found
