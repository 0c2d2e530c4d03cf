"""The run time on a stream without a simulator: normal driving, and inputs that are late, missing or invalid."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from offpiste.core.conventions import DT
from offpiste.core.errors import NoPlan
from offpiste.logs.measurements import Image
from offpiste.planning import mppi
from offpiste.planning.course import Course, CourseTracker
from offpiste.rig.outputs import Timeouts
from runtime.stream import Stream, extract_features, reading, scan, straight_drive


def speed_of(state):
    return float(np.hypot(*state[3:5]))


def speed(stream):
    return speed_of(stream.states[-1])


def commands(stream):
    return np.stack([c.command for c in stream.controls])


@pytest.fixture(scope="module")
def driven():
    return straight_drive().run(4.0)


def test_it_follows_its_course_at_speed(driven):
    x, y = driven.states[-1][:2]
    assert x > 8.0
    assert abs(y) < 0.6
    assert 3.5 < speed(driven) < 5.5
    assert driven.modes() == [("stopped", "no scan"), ("stopped", "no plan"), ("driving", "")]
    assert driven.runtime.dropped == {"lidar: before the first poses": 1}


def test_the_same_messages_give_the_same_controls(driven):
    again, other = straight_drive(), straight_drive(seed=1)
    again.run(0.6)
    other.run(0.6)
    np.testing.assert_array_equal(commands(again), commands(driven)[:30])
    assert not np.array_equal(commands(other), commands(driven)[:30])


@dataclass
class ChangedGround(Stream):
    """A stream whose ground rises by half a metre at a time, or `leak` earlier [s]."""

    change: float = np.inf
    leak: float = 0.0

    def _step(self, row):
        self.height = 0.5 if row * DT + self.leak > self.change else 0.0
        super()._step(row)


@pytest.mark.parametrize("leak", [0.0, 0.4])
def test_commands_and_plans_do_not_depend_on_what_is_measured_later(leak):
    change = 1.55
    ours, others = (ChangedGround(straight_drive().runtime, change=at, leak=leak) for at in (np.inf, change))
    ours.run(2.2)
    others.run(2.2)
    same = np.array([np.array_equal(a.command, b.command) for a, b in zip(ours.controls, others.controls, strict=True)])
    until = DT * np.arange(len(same)) <= change
    assert same[until].all() == (leak == 0.0)
    assert not same.all()
    pairs = zip(ours.runtime.predictions, others.runtime.predictions, strict=True)
    planned = [np.array_equal(one.state, other.state) for one, other in pairs if one.time <= change]
    assert len(planned) > 5
    assert all(planned) == (leak == 0.0)


@pytest.mark.parametrize("latency", [0.0, 0.3])
def test_a_plan_starts_where_the_vehicle_then_is(latency):
    # The vehicle moves as the model says, so predictions must be met: committed controls, warm start, all of it.
    stream = straight_drive(latency=latency).run(1.5)
    checked = 0
    for plan in stream.runtime.predictions:
        first = round(plan.time / DT)
        rows = np.arange(first + 1, min(first + 6, len(stream.states)))
        # What acts from a plan's start on is that plan, until the next one made 0.1 s later.
        if plan.time > 0.5 and len(rows) == 5:
            met = np.array([stream.states[row] for row in rows])
            np.testing.assert_allclose(plan.state[:5], met, atol=2e-3)
            checked += 1
    assert checked >= 6
    acting = [c.time for c in stream.controls if c.mode == "driving"]
    assert acting[0] == pytest.approx(0.1 + latency, abs=DT / 2)  # the first scan that counts comes at 0.1 s


def test_a_clock_that_goes_back_restarts_everything():
    stream = straight_drive().run(1.5)
    before = stream.runtime.course_tracker.progress
    for row in range(60):  # the same runtime on another clock, 1 s behind, at the begin of its course
        t = 0.5 + row * DT
        stream.runtime.vehicle(reading(t, *stream.states[0][:3], 0.0, 0.0, 0.0))
        if row % 5 == 0:
            stream.runtime.scan(scan(t))
        stream.runtime.step(t)
    modes = stream.modes()
    assert ("stopping", "the clock went back") in modes
    assert modes[-1] == ("driving", "")
    assert stream.runtime.course_tracker.progress < before - 1.0


def test_after_a_pose_that_jumps_the_vehicle_may_be_anywhere_on_its_course():
    """A corrected pose jumps from one leg of a hairpin to the other without passing the bend."""
    turn = np.linspace(-np.pi / 2, np.pi / 2, 60)
    bend = np.stack((60 + 10 * np.cos(turn), 10 + 10 * np.sin(turn)), axis=1)
    hairpin = np.concatenate(([[0.0, 0.0]], bend, [[0.0, 20.0]]))
    course, runtime = Course(hairpin, np.full(len(hairpin), 5.0)), straight_drive().runtime
    runtime.follower.tracker = CourseTracker(course.densified(0.25))
    driven = course.densified(0.1).path[:760]
    again = np.stack((np.arange(35, 37, 0.1), np.zeros(20)), axis=1)
    for row, (x, y) in enumerate(np.concatenate((driven, again)).tolist()):
        runtime.vehicle(reading(0.02 * row, x, y, 0.0, 5.0, 0.0, 0.0))
    assert runtime.course_tracker.progress == pytest.approx(36.9, abs=0.3)


def test_without_scans_it_slows_down_and_stops():
    stream = straight_drive(slow=1.0, stream={"scans": lambda t: t < 2.0}).run(2.86)
    assert stream.modes()[-1] == ("degraded", "late scan")
    pedal = commands(stream)[:, 0] - commands(stream)[:, 1]
    assert pedal[round(1.9 / DT) : round(2.4 / DT)].mean() > 0.3
    assert pedal[-round(0.2 / DT) :].mean() < 0.1, "the speed itself follows a second later"
    stream.run(3.5)
    assert stream.modes()[-2:] == [("stopping", "no scan"), ("stopped", "no scan")]
    assert speed(stream) < 0.3
    times = {event.why: event.time for event in reversed(stream.runtime.events)}
    assert times["late scan"] == pytest.approx(1.9 + 0.5, abs=2 * DT)


def test_a_stop_is_completed_before_it_drives_away():
    stream = straight_drive(stream={"reads": lambda t: not 1.0 <= t < 1.3}).run(3.2)
    why = "no state of the vehicle"
    assert stream.modes()[-2:] == [("stopping", why), ("driving", "")]
    lost = commands(stream)[round(1.12 / DT) : round(1.3 / DT)]
    np.testing.assert_array_equal(lost[:, 0], 0.0)
    np.testing.assert_array_equal(lost[:, 1], 0.5)
    assert min(map(speed_of, stream.states[55:])) < 0.3


def test_plans_made_during_a_stop_start_from_the_braked_vehicle():
    stream = straight_drive(stream={"reads": lambda t: not 1.5 <= t < 1.8}, latency=0.3).run(2.9)
    rows = [(round(p.time / DT) + 1, p.state[0]) for p in stream.runtime.predictions if 2.05 < p.time < 2.75]
    assert len(rows) >= 5
    for row, planned in rows:
        assert stream.controls[row - 1].mode == "stopping"
        assert speed_of(planned) == pytest.approx(speed_of(stream.states[row]), abs=0.02)


def test_an_empty_map_stops_it():
    stream = straight_drive().run(1.5)
    stream.runtime.forget_map()
    stream.height = 1000.0  # echoes far above
    stream.run(0.2)
    assert stream.modes()[-1] == ("stopping", "empty map")
    stream.run(1.8)
    assert stream.modes()[-1] == ("stopped", "empty map")
    assert speed(stream) < 0.3


def test_a_plan_that_fails_leaves_the_last_one_for_a_while(monkeypatch):
    stream = straight_drive().run(1.5)
    planned = stream.runtime.follower.schedule.latest.controls

    def fails(*_, **__):
        raise NoPlan("none of 64 sampled trajectories has a finite cost")

    monkeypatch.setattr(mppi, "improve", fails)
    stream.run(0.5)
    last = stream.runtime.follower.schedule.latest
    assert last.controls is planned
    row = round(last.start / DT)
    np.testing.assert_allclose(commands(stream)[row : row + 20], planned[:20], atol=1e-7)
    stream.run(0.5)
    assert stream.modes()[-1] == ("stopping", "no plan")
    assert len(stream.runtime.failures) >= 5
    monkeypatch.undo()
    stream.run(3.5)
    assert stream.modes()[-1] == ("driving", "")


def test_it_stops_at_the_end_of_its_course():
    stream = straight_drive(length=8.0).run(6.5)
    assert stream.modes()[-1] == ("stopped", "end of the course")
    assert 5.0 < stream.states[-1][0] < 14.0


def test_without_images_it_continues_in_degraded_mode():
    stream = straight_drive(camera=extract_features, stream={"images": lambda t: t < 1.2}).run(1.5)
    layers = stream.runtime._mapper.layers()
    assert layers.features.shape[2] == 4  # codes of 3 features
    assert layers.valid.sum() > 100
    codes = layers.features[layers.valid]
    stream.run(1.5)
    assert stream.modes()[-1] == ("degraded", "no image")
    assert speed(stream) > 2.0
    # The map holds codes, not features: those of the one colour that was seen.
    features = extract_features(np.full((98, 140, 3), 120, np.uint8))[:1, 0]
    expected = stream.runtime._dynamics.encoder(torch.from_numpy(features), torch.ones(1, dtype=torch.bool)).numpy()
    np.testing.assert_allclose(codes, np.broadcast_to(expected, codes.shape), atol=1e-5)


def test_features_that_are_not_finite_count_as_no_image():
    broken = []

    def extractor(pixels):
        return np.full_like(extract_features(pixels), np.nan) if broken else extract_features(pixels)

    stream = straight_drive(camera=extractor).run(1.0)
    broken.append(True)
    stream.run(2.2)
    assert stream.modes()[-1] == ("degraded", "no image")
    assert stream.runtime.dropped["images: features are not finite"] >= 3
    assert np.isfinite(commands(stream)).all()
    assert np.isfinite(stream.runtime._mapper.layers().features[stream.runtime._mapper.layers().valid]).all()


def test_slow_odometry_drives_where_it_is_expected_and_comes_after_the_scans():
    def slow(t):
        return round(t / DT) % 20 == 0  # every 0.4 s

    modes = []
    for timeouts in (Timeouts(), Timeouts(state=0.6, scan=1.0, scan_limit=1.5)):
        stream = straight_drive(timeouts=timeouts, stream={"reads": slow}).run(4.0)
        modes.append(stream.modes()[-1])
    assert modes[0] == ("stopped", "no state of the vehicle")
    assert modes[1] == ("driving", "")
    assert not any("pose is not known" in why for why in stream.runtime.dropped)
    assert speed(stream) > 0.5


def test_messages_that_cannot_be_used_are_dropped_and_counted():
    stream = straight_drive(camera=extract_features).run(2.0)
    driver, pixels = stream.runtime, np.full((98, 140, 3), 120, np.uint8)
    driver.image(Image(1.4, "eye", pixels))  # older than the last: 1.5
    driver.image(Image(1.9, "eye", pixels))  # late, but newer than the last: counts with its own stamp
    assert driver._mapper.image_time == 1.9
    driver.image(Image(2.05, "eye", pixels))  # a little ahead of poses: it waits for them
    driver.image(Image(7.0, "eye", pixels))  # from the future
    before = driver._mapper.scan_time
    broken = scan(1.95)
    driver.scan(type(broken)(1.95, "lidar", np.full_like(broken.points, np.nan), None, broken.intensity))
    assert driver._mapper.scan_time == before
    points = np.where(broken.points[:, :1] > 0, np.nan, broken.points)  # only what lies behind is finite
    driver.scan(type(broken)(1.96, "lidar", points, None, broken.intensity))
    assert driver._mapper.scan_time == 1.96
    latest = driver._track.latest
    driver.vehicle(replace(latest, time=2.06, position=latest.position + 0.06 * latest.velocity))
    assert driver._mapper.image_time == 2.05
    driver.vehicle(reading(2.07, np.nan, 0.0, 0.0, 1.0, 0.0, 0.0))
    driver.vehicle(reading(1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0))
    driver.vehicle(reading(11.5, 40.0, 0.0, 0.0, 1.0, 0.0, 0.0))
    assert driver.dropped == {
        "eye: before the first poses": 1,
        "lidar: before the first poses": 1,
        "eye: stamps repeat or go back": 1,
        "eye: stamps ahead of the clock": 1,
        "scans without a finite point": 1,
        "readings of the vehicle that are not finite": 1,
        "readings of the vehicle whose stamps repeat or go back": 1,
        "readings of the vehicle: stamps ahead of the clock": 1,
    }


def test_a_pose_that_jumps_empties_the_map():
    stream = straight_drive().run(1.5)
    assert stream.runtime._mapper.layers().known.any()
    stream.scans = lambda t: False
    stream.model_state = replace(
        stream.model_state, state=stream.model_state.state + torch.tensor([0.0, 2.0, 0.0, 0.0, 0.0, 0.0])
    )
    stream.run(DT)
    assert not stream.runtime._mapper.layers().known.any()
    assert stream.modes()[-1] == ("stopping", "no scan")
    stream.scans = lambda t: True
    stream.run(4.0)
    assert stream.modes()[-1] == ("driving", "")
