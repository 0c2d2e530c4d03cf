"""What is shown of a drive: the newest of each ring, whatever the viewer's pace; regions where the run has a spread."""

import shutil
import signal
import socket
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch

from live.made_up_robot import write_course, write_rig
from offpiste.cli import main
from offpiste.closed_loop.recording import LIFT
from offpiste.core.errors import LiveError
from offpiste.live.packing import pack_course, pack_layers, pack_measured, pack_plan, packed
from offpiste.live.part import Part
from offpiste.live.parts.view import Showing, shown_ground, view
from offpiste.live.plan_regions import PlanRegions
from offpiste.live.reception import CourseRequest
from offpiste.live.session import LiveSettings, ViewSettings, new_session
from offpiste.live.viewers.viewer import VIEWERS, listening_at
from offpiste.logs.measurements import Image
from offpiste.planning.course import Course
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.follower import TimedPlan
from offpiste.runtime.planner import load_planner
from offpiste.runtime.prediction import Prediction
from offpiste.training.checkpoint import load_json, save_tensors
from offpiste.uncertainty.fit import FILE
from offpiste.uncertainty.spread import Spread, inputs_of
from planning_maps import WHEELS, layers

RUN = "pretrained:proving-ground/parametric"
X = np.arange(0.0, 60.0)


class Notes:
    """A viewer that keeps what it is given, each after a while."""

    def __init__(self, slow=0.0):
        self.slow, self.given = slow, []

    def __getattr__(self, name):
        def note(*given):
            time.sleep(self.slow)
            self.given.append((name, given))

        return note

    def of(self, name):
        return [given for kind, given in self.given if kind == name]


def reading(now, x=1.0):
    return VehicleReading(now, np.array((x, 0, 2.0)), np.array((0, 0, 0, 1.0)), np.zeros(3), 0.0, np.zeros(4))


def plan_at(now, speed=2.0):
    states = np.zeros((250, 6))
    states[:, 0], states[:, 3] = 1.0 + speed * 0.02 * np.arange(1, 251), speed
    return TimedPlan(now, now - 0.1, torch.tensor([[0.4, 0.0, 0.2]]).repeat(250, 1)), Prediction(now, states)


@contextmanager
def showing(folder, viewer, regions=None):
    settings = LiveSettings(write_rig(folder), RUN, None, CourseRequest(write_course(folder)))
    with new_session(settings) as session:
        interrupt = signal.getsignal(signal.SIGINT)
        part = Part("view", session)
        signal.signal(signal.SIGINT, interrupt)  # which processes of a drive ignore
        yield part, Showing(part, viewer, regions)


def feed(session, now, plan=None):
    """What other processes hand over: a course, a slope along x, a reading, a plan, a command, an image, states."""
    session.ring("readings").write(pack_measured(reading(now), control=None))
    session.ring("course").write(pack_course(Course(np.stack((X, 0 * X), axis=1), np.full(60, 4.0))))
    session.ring("map").write(pack_layers(layers(plane=(0.5, 0.0)), scan_time=now - 0.2, image_time=np.inf))
    session.ring("plans").write(pack_plan(*(plan or plan_at(now)), empty=False, stuck=False))
    session.ring("commands").write(packed({"time": now, "applied": np.array((0.4, 0.0, -0.2)), "mode": "driving"}))
    session.ring("images").write(pack_measured(Image(now, "front", np.full((4, 6, 3), 7, np.uint8))))
    status = {"state": "stopping: no plan", "tick_p99_ms": 4.0, "map_age_p99_ms": np.nan, "speed_mps": 1.5}
    session.ring("status-control").write(packed(status))


def test_each_part_of_a_drive_is_shown_on_the_ground(tmp_path):
    notes, now = Notes(), time.time()
    with showing(tmp_path, notes) as (part, shown):
        shown.update()
        assert not notes.given, "nothing before the vehicle's place is known"
        feed(part.session, now)
        shown.update()
    assert notes.of("pose")[0][0].position[0] == 1.0
    _, course = notes.of("course")[-1]
    on_map = course[:, 0] <= 20
    np.testing.assert_allclose(course[on_map, 2], 0.5 * course[on_map, 0] + LIFT, atol=0.26)
    np.testing.assert_allclose(course[~on_map, 2], 2.0 + LIFT, err_msg="off the map: the vehicle's height")
    plan = notes.of("plan")[0][0]
    assert plan.places.shape == (50, 3)
    np.testing.assert_allclose(plan.places[:, 0], 1.04 + 0.2 * np.arange(50))
    np.testing.assert_allclose(plan.speed, 2.0)
    assert plan.regions == ()
    assert notes.of("image")[0][0].pixels.shape == (4, 6, 3)
    assert notes.of("mode") == [(pytest.approx(now, abs=60), "stopping", "no plan")]
    numbers = {kind: values for _, kind, values in notes.of("numbers")}
    assert numbers["latencies"] == {"tick_p99_ms": 4.0}, "what is not known is no number"
    assert numbers["command"] == {"throttle": 0.4, "brake": 0.0, "steer": -0.2}
    assert numbers["speed"] == {"speed": 1.5}


def test_cells_of_the_map_have_their_values_and_colours_and_unknown_ones_are_left_out():
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


def test_a_slow_viewer_is_shown_the_newest_and_leaves_out_the_rest(tmp_path):
    notes = Notes(slow=0.05)
    with showing(tmp_path, notes) as (part, shown):
        began, written = time.monotonic(), 0
        while time.monotonic() - began < 2.0:
            for _ in range(10):
                written += 1
                feed(part.session, float(written))
            shown.update()
        times = [given[0].time for given in notes.of("plan")]
    assert 2 <= len(times) <= written / 10
    assert all(time % 10 == 0 for time in times), "the last of those that had come"
    assert times == sorted(set(times))


def with_spread(folder):
    """The shipped parametric run with a spread whose growth is known."""
    planner = load_planner(RUN)
    run = Path(shutil.copytree(planner.folder, folder / "run"))
    spread = Spread(inputs_of(planner.dynamics.vehicle, planner.dynamics.codes))
    with torch.no_grad():
        for parameter in spread.layers.parameters():
            parameter.zero_()
        spread.layers[-1].bias.copy_(torch.tensor((0.0, 1.0)))
    save_tensors(run / FILE, spread.state_dict(), weights_sha256=load_json(run / "model.json")["weights_sha256"])
    return load_planner(run)


def test_regions_are_ellipses_as_large_as_the_spread_says(tmp_path):
    planner = with_spread(tmp_path)
    plan, prediction = plan_at(100.0)
    regions = PlanRegions(planner.dynamics, planner.spread, WHEELS.numpy())
    outlines = regions.outlines(layers(), plan, prediction)
    assert len(outlines) == 5
    begin, freedom = np.logaddexp(0, -2.0) ** 2, 2 + np.logaddexp(0, 1.0)
    factor = np.sqrt(freedom * (0.2 ** (-2 / freedom) - 1))  # P(r) = 1 - (1 + r² / ν)^(-ν / 2)
    for second, outline in enumerate(outlines, start=1):
        steps = np.arange(1, 5 * second + 1)
        for axis, bias in enumerate((0.0, 1.0)):
            scale = (0.2 * np.sqrt(begin + 0.2 * np.logaddexp(0, bias) ** 2 * steps)).sum()
            assert np.ptp(outline[:, axis]) / 2 == pytest.approx(factor * scale, rel=1e-4)
        assert (outline.max(axis=0) + outline.min(axis=0))[0] / 2 == pytest.approx(1 + 2.0 * second)
    turned = prediction.state.copy()
    turned[:, 2] = np.pi / 2
    sideways = PlanRegions(planner.dynamics, planner.spread, WHEELS.numpy()).outlines(
        layers(), plan, Prediction(100.0, turned)
    )
    assert np.ptp(sideways[4][:, 0]) == pytest.approx(np.ptp(outlines[4][:, 1]))


def test_regions_are_shown_with_the_plan(tmp_path):
    notes, planner = Notes(), with_spread(tmp_path)
    with showing(tmp_path, notes, PlanRegions(planner.dynamics, planner.spread, WHEELS.numpy())) as (part, shown):
        feed(part.session, time.time())
        shown.update()
    (plan,) = notes.of("plan")[0]
    assert [region.shape for region in plan.regions] == [(25, 3)] * 5


def refused(capsys, *arguments):
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    assert ended.value.code == 1
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    return message


def test_what_cannot_be_shown_is_refused_in_a_line(tmp_path, capsys):
    live = ("live", write_rig(tmp_path), "--run", RUN, "--course", write_course(tmp_path))
    assert "no viewer 'foxglov'; did you mean 'foxglove'?" in refused(capsys, *live, "--view", "foxglov")
    assert "only a live drive is shown" in refused(capsys, *live, "--view", "rerun", "--lockstep")
    assert "would show nothing; give --view, too" in refused(capsys, *live, "--view-at", "drive.rrd")
    (there := tmp_path / "there.rrd").write_bytes(b"")
    assert "exists already" in refused(capsys, *live, "--view", "rerun", "--view-at", str(there))
    with pytest.raises(LiveError, match="is no host and port"):
        listening_at("8765")
    with listening_socket() as port, pytest.raises(LiveError, match="cannot listen there"):
        listening_at(f"127.0.0.1:{port}")
    assert {"foxglove", "rerun"} <= set(VIEWERS)


def test_where_it_was_killed_the_next_one_writes_another_file(tmp_path, monkeypatch):
    places = []

    class Writer(Notes):
        def __init__(self, place, *_):
            super().__init__()
            places.append(place)
            self.where = place

    monkeypatch.setitem(VIEWERS._entries, "writer", Writer)
    begun = tmp_path / "drive.rrd"
    course = CourseRequest(write_course(tmp_path))
    for place in (str(begun), "", "127.0.0.1:9876"):
        begun.write_bytes(b"what the killed one wrote")
        settings = LiveSettings(write_rig(tmp_path), RUN, None, course, view=ViewSettings("writer", place))
        with new_session(settings) as session:
            session.ring("end").write(b"end")
            view(session, cameras=False)
    assert places == [str(tmp_path / "drive-2.rrd"), "", "127.0.0.1:9876"]
    assert begun.read_bytes() == b"what the killed one wrote"


@contextmanager
def listening_socket():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        yield taken.getsockname()[1]
