"""Faults while control drives: a clock that stands still or goes back, a process that comes back in the middle of a
stop, signals to all processes at once, a server of processes that dies, and the end."""

import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from live.made_up_robot import ENABLE, write_course, write_rig
from live.test_all_processes import runs
from live.test_supervisor import RUN, Drive, drove, first_stop
from offpiste.core.errors import LiveError, PlanningError, RigError
from offpiste.core.shipped import run_folder
from offpiste.core.signals import GROUP_SIGNALS
from offpiste.live.commands import run_live
from offpiste.live.driver import refuse_unmeasured
from offpiste.live.packing import pack_measured, pack_plan, packed, unpacked
from offpiste.live.part import STAMP
from offpiste.live.parts.control import MODE
from offpiste.live.reception import CourseRequest
from offpiste.live.session import LiveSettings, RecordSettings, new_session
from offpiste.logs.ros.writer import make
from offpiste.planning.caution import AddSpread
from offpiste.rig.rig import load_rig
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.follower import TimedPlan
from offpiste.runtime.planner import load_planner
from offpiste.runtime.prediction import Prediction
from offpiste.runtime.settings import RuntimeSettings
from offpiste.transport.zenoh_transport import ZenohSettings
from offpiste.uncertainty.fit import FILE as SPREAD
from transport.routers import until


class Moving(Drive):
    """A vehicle whose speed and clock are given."""

    at, speed, gear, clock = 1.0, 0.0, 1.0, staticmethod(time.time)

    @property
    def progress(self):
        """Along the course, as control says it with what it commanded last [m]."""
        return unpacked(self.rings["commands"].newest().data)["progress"]

    def feed(self, *, reads=True, plans=True):
        now = self.clock()
        self.rings["clock"].write(STAMP.pack(now, time.monotonic()))
        if reads:
            place, turn = np.array((self.at + self.speed * (now % 10), 0, 0)), np.array((0, 0, 0, 1.0))
            reading = VehicleReading(now, place, turn, np.array((self.speed, 0, 0)), 0.0, np.zeros(4))
            self.rings["readings"].write(pack_measured(reading, control=None, came=time.monotonic()))
        self.rings["map-state"].write(packed({"scan_time": now, "image_time": np.inf}))
        if plans:
            plan = TimedPlan(now, now, torch.tensor([[0.4, 0.0, 0.2]]).repeat(250, 1), self.gear)
            states = np.tile((0.0, 0, 0, 2.0, 0, 0), (250, 1))
            self.rings["plans"].write(pack_plan(plan, Prediction(now, states), empty=False, stuck=False))


@pytest.fixture
def moving(tmp_path):
    with closing(Moving(tmp_path, clock="clock")) as drive:
        yield drive


def test_a_clock_that_stands_still_stops_the_vehicle(moving):
    assert moving.drives(), moving.supervisor.look()
    frozen, moment = time.time(), time.monotonic()
    moving.clock = lambda: frozen
    parts = moving.run(1.0)
    assert first_stop(moving, moment) < 0.1 + 0.2, "readings whose stamps repeat are as old as the first"
    assert "no state of the vehicle" in parts["control"][1]
    moving.clock = time.time
    assert moving.drives(20), "once it runs again"


def test_readings_that_run_on_without_their_clock_stop_it_too(moving):
    assert moving.drives(), moving.supervisor.look()
    clock, moment = moving.rings.pop("clock"), time.monotonic()
    moving.rings["clock"] = type("Silent", (), {"write": staticmethod(lambda _: True)})
    parts = moving.run(1.6)
    assert first_stop(moving, moment) < 1.0 + 0.3
    assert "stands still" in parts["control"][1] or "no state" in parts["control"][1]
    moving.rings["clock"] = clock


def test_a_clock_that_goes_back_stops_it_and_it_drives_again_by_the_new_time(moving):
    moving.at = 9.0
    assert moving.drives(), moving.supervisor.look()
    assert moving.progress == pytest.approx(9.0, abs=0.3)
    moment = time.monotonic()
    moving.at, moving.clock = 2.0, lambda: time.time() - 1000.0  # as a simulator that begins again
    moving.run(0.3)
    stops = [after for after, command in moving.since(moment) if command.acceleration < 0]
    assert stops, "though it drives on at once, since it is at a standstill"
    assert moving.drives(20)
    assert moving.progress == pytest.approx(2.0, abs=0.3)


@pytest.mark.parametrize("blow", [signal.SIGKILL, signal.SIGSTOP])
def test_a_stop_is_completed_by_the_control_that_comes_back(moving, blow):
    assert moving.drives(), moving.supervisor.look()
    pid, speeds = moving.pid("control"), moving
    steer = moving.heard[-1][1].steering_angle
    os.kill(pid, blow)
    moving.run(0.3)
    speeds.speed = 3.0
    if blow == signal.SIGSTOP:
        os.kill(pid, signal.SIGCONT)
    assert until(lambda: "stopping" in moving.run(0.1)["control"][1], 30), moving.supervisor.look()
    moment = time.monotonic()
    parts = moving.run(1.0)
    assert "stopping" in parts["control"][1], "it has readings and plans, and does not stand"
    heard = [drive for _, drive in moving.since(moment)]
    assert all(drive.acceleration < 0 for drive in heard)
    assert heard[0].steering_angle == pytest.approx(steer, abs=0.06), "no jump of the steering"
    speeds.speed = 0.0
    assert moving.drives(20), "from the standstill"


def test_a_control_that_comes_back_keeps_the_gear_until_the_standstill(moving):
    assert moving.drives(), moving.supervisor.look()

    def gears():
        return {unpacked(one.data)["gear"] for one in moving.rings["commands"].since(begun)}

    begun, moving.gear = moving.rings["commands"].written, -1.0
    assert until(lambda: (moving.run(0.1), -1.0 in gears())[1], 20)
    os.kill(moving.pid("control"), signal.SIGKILL)
    moving.speed, moving.gear = -3.0, 1.0
    moving.run(0.3)
    begun = moving.rings["commands"].written
    assert until(lambda: "stopping" in moving.run(0.1)["control"][1], 30), moving.supervisor.look()
    moving.run(0.5)
    assert gears() == {-1.0}, "it still moves"
    moving.speed = 0.0
    assert until(lambda: (moving.run(0.1), 1.0 in gears())[1], 20)


@pytest.mark.parametrize("first", ["", "control", "watchdog"])
def test_the_last_that_is_heard_is_the_stop_whoever_ends_first(moving, first):
    assert moving.drives(), moving.supervisor.look()
    assert until(lambda: moving.run(0.1)["watchdog"][1] == "ready", 30)
    if first:
        moving.supervisor._names.remove(first)
        os.kill(moving.pid(first), signal.SIGKILL)
    moment = time.monotonic()
    moving.supervisor.end()
    time.sleep(0.2)
    assert first_stop(moving, moment) < 0.3
    assert moving.heard[-1][1].acceleration < 0
    stops = [after for after, drive in moving.since(moment) if drive.acceleration < 0]
    assert stops[-1] - stops[0] > 0.9
    assert max(np.diff(stops)) < 0.4, "until the end"


def test_the_watchdog_stops_on_where_the_memory_was_removed_and_control_is_gone(moving):
    assert moving.drives(), moving.supervisor.look()
    assert until(lambda: moving.run(0.1)["watchdog"][1] == "ready", 30)
    moving.supervisor._ring("end")
    shutil.rmtree(moving.session.folder)  # as control did at its end, once their parent was gone
    os.kill(moving.pid("control"), signal.SIGKILL)
    moment = time.monotonic()
    time.sleep(1.0)
    stops = [after for after, drive in moving.since(moment) if drive.acceleration < 0]
    assert len(stops) > 5
    assert stops[-1] > 0.8


def test_before_the_first_command_none_counts_as_interrupted(tmp_path):
    with closing(Moving(tmp_path)) as drive:
        said = []
        drive.vehicle.subscribe(MODE, lambda one: said.append(drive.vehicle.decode(one).data), history=True)
        assert until(lambda: "waits for readings" in str(drive.supervisor.look()["control"][1]), 60)
        time.sleep(0.3)
        assert drive.drives(), drive.supervisor.look()
        assert said
        assert not any("interrupted" in one for one in said)


def test_processes_leave_ending_to_their_parent(moving):
    assert moving.drives(), moving.supervisor.look()
    for number in GROUP_SIGNALS:
        for name in ("control", "watchdog"):
            os.kill(moving.pid(name), number)
    moment = time.monotonic()
    moving.run(0.6)
    assert drove(moving, moment)
    assert moving.supervisor.restarts == {"control": 0, "watchdog": 0}


def test_where_the_server_of_the_processes_dies_no_process_runs_twice(moving):
    assert moving.drives(), moving.supervisor.look()
    before = [moving.pid("control"), moving.pid("watchdog")]
    server = int(Path(f"/proc/{before[0]}/stat").read_text().rpartition(")")[2].split()[1])
    os.kill(server, signal.SIGKILL)
    assert until(lambda: (moving.run(0.2), moving.supervisor.restarts)[1] == {"control": 1, "watchdog": 1}, 60)
    assert until(lambda: not any(runs(pid) for pid in before), 5)
    del moving.heard[:]
    assert moving.drives(60)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_the_stop_is_sent_at_the_end_though_the_server_of_the_processes_is_gone(moving, number):
    assert moving.drives(), moving.supervisor.look()
    server = int(Path(f"/proc/{moving.pid('control')}/stat").read_text().rpartition(")")[2].split()[1])
    os.kill(server, number)
    time.sleep(0.1)
    moment = time.monotonic()
    moving.supervisor.end()
    time.sleep(0.1)
    stops = [after for after, drive in moving.since(moment) if drive.acceleration < 0]
    assert stops[-1] - stops[0] > 0.9
    assert moving.heard[-1][1].acceleration < 0


def test_the_switch_is_heard_over_the_bridge_by_the_type_in_the_rig(tmp_path):
    types = '[live.types]\n"/enable" = "std_msgs/msg/Bool"\n'
    with closing(Moving(tmp_path, ENABLE + types, keys="bridge")) as drive:
        assert until(lambda: (drive.run(0.1), len(drive.heard) > 20)[1], 60)
        switch = drive.vehicle.publisher("/enable", "std_msgs/msg/Bool")
        for _ in range(60):
            switch(make("std_msgs/Bool", data=True))
            drive.run(0.05)
        assert drive.heard[-1][1].acceleration > 0
        moment = time.monotonic()
        drive.vehicle._session.put("drive", b"whatever another commander sends")
        drive.run(0.3)
        assert first_stop(drive, moment) < 0.3, "of any type"


@pytest.mark.parametrize(
    ("changed", "options", "what"),
    [
        ({"robot": ZenohSettings(keys="bridge"), "drive": True}, {}, r"type of the enable topic /enable.*live.types"),
        ({"record": RecordSettings(Path("a.mcap"))}, {"lockstep": True}, "--record would do nothing"),
        ({"status": Path("a.csv")}, {"replay": Path("a.mcap")}, "--status would do nothing"),
        ({"clock": "stamps"}, {"lockstep": True}, "--clock stamps would do nothing"),
        ({"clock": "clock"}, {"replay": Path("a.mcap")}, "--clock clock would do nothing"),
        ({}, {"lockstep": True, "replay": Path("a.mcap")}, "--lockstep would do nothing"),
        ({}, {"commands": Path("a.csv")}, "--commands would do nothing"),
        ({"seconds": 0.0}, {}, "0 seconds"),
    ],
)
def test_options_that_would_do_nothing_are_refused(tmp_path, changed, options, what):
    rig, course = write_rig(tmp_path, ENABLE), CourseRequest(write_course(tmp_path))
    given = {"lockstep": False, "replay": None, "commands": None} | options
    with pytest.raises(LiveError, match=what):
        run_live(LiveSettings(rig, RUN, None, course, **changed), **given)


def test_a_risk_that_needs_a_spread_is_refused_before_anything_starts(tmp_path):
    run = tmp_path / "run"
    shutil.copytree(run_folder(RUN), run, ignore=shutil.ignore_patterns(SPREAD))
    course, runtime = CourseRequest(write_course(tmp_path)), RuntimeSettings(risk=AddSpread())
    settings = LiveSettings(write_rig(tmp_path, actuators=True), str(run), None, course, runtime)
    with pytest.raises(PlanningError, match="needs a spread"):
        run_live(settings, lockstep=False, replay=None, commands=None)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_not_there_is_refused_before_anything_starts(tmp_path):
    course, runtime = CourseRequest(write_course(tmp_path)), RuntimeSettings(device="cuda")
    settings = LiveSettings(write_rig(tmp_path), RUN, None, course, runtime)
    with pytest.raises(PlanningError, match="no GPU 'cuda' for planning"):
        run_live(settings, lockstep=False, replay=None, commands=None)


def test_the_timeouts_of_the_rig_are_those_of_the_drive(tmp_path, monkeypatch):
    begun, more = [], "[live.timeouts]\nstate = 0.25\n"
    monkeypatch.setattr("offpiste.live.commands.supervise", lambda settings, *_: begun.append(settings))
    course = CourseRequest(write_course(tmp_path))
    settings = LiveSettings(write_rig(tmp_path, more, actuators=True), RUN, None, course)
    run_live(settings, lockstep=False, replay=None, commands=None)
    assert begun[0].runtime.timeouts == replace(settings.runtime.timeouts, state=0.25)


@pytest.mark.parametrize("run", [RUN, "pretrained:proving-ground/dc"])
def test_a_model_that_reads_what_the_rig_lacks_is_refused_before_anything_starts(tmp_path, run):
    course = CourseRequest(write_course(tmp_path))
    with pytest.raises(LiveError, match=r"reads brake, .*engine_rpm, which rig 'made up' does not have"):
        run_live(LiveSettings(write_rig(tmp_path), run, None, course), lockstep=False, replay=None, commands=None)
    with pytest.raises(LiveError, match=r"reads images, and rig 'made up' has no cameras"):
        refuse_unmeasured(load_planner("pretrained:proving-ground/dc"), load_rig(write_rig(tmp_path, actuators=True)))


@pytest.mark.parametrize(
    ("more", "change", "what"),
    [
        ('[live.types]\n"/odom" = "my_msgs/msg/Odom"\n', "", r"my_msgs/msg/Odom is not known.*live.definitions"),
        (ENABLE + 'field = "on"\n[live.types]\n"/enable" = "std_msgs/msg/Bool"\n', "", r"'on' is no such field"),
        ("", '"drive.accel', r"a field is not one of its type"),
    ],
)
def test_types_and_fields_are_refused_before_anything_starts(tmp_path, more, change, what):
    rig = Path(write_rig(tmp_path, more, actuators=True))
    rig.write_text(rig.read_text().replace('"drive.acceleration', change or '"drive.acceleration'))
    settings = LiveSettings(str(rig), RUN, None, CourseRequest(write_course(tmp_path)), drive=True)
    with pytest.raises(RigError, match=what):
        run_live(settings, lockstep=False, replay=None, commands=None)


def test_driving_without_a_dead_mans_switch_is_warned_of(tmp_path, caplog):
    settings = LiveSettings(write_rig(tmp_path), RUN, None, CourseRequest(write_course(tmp_path)), drive=True)
    with pytest.raises(LiveError, match="does not have"):
        run_live(settings, lockstep=False, replay=None, commands=None)
    assert "without a dead man's switch" in caplog.text


LEFT = """
import os, sys
from pathlib import Path
from offpiste.live.reception import CourseRequest
from offpiste.live.session import LiveSettings, new_session
with new_session(LiveSettings("rig", "run", None, CourseRequest(Path("a")))) as session:
    print(session.folder, flush=True)
    sys.stdin.readline()
"""


def test_memory_of_a_killed_session_is_removed_by_the_next_and_that_of_a_living_one_is_not():
    owners = [subprocess.Popen([sys.executable, "-c", LEFT], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
              for _ in range(2)]  # fmt: skip
    killed, living = (Path(owner.stdout.readline().strip()) for owner in owners)
    owners[0].kill()
    owners[0].wait()
    assert killed.is_dir()
    with new_session(LiveSettings("rig", "run", None, CourseRequest(Path("a")))) as session:
        assert not killed.exists()
        assert living.is_dir()
    assert not session.folder.exists()
    owners[1].communicate("\n")
    assert not living.exists()


def test_what_was_commanded_says_where_the_course_was_left(moving):
    assert moving.drives(), moving.supervisor.look()
    assert unpacked(moving.rings["commands"].newest().data)["course"] == 1
    assert moving.progress == pytest.approx(1.0, abs=0.3)
