"""A stuck vehicle backs out, turns round, drives around the place, and gives up after some attempts."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from offpiste.core.conventions import DT
from offpiste.core.errors import PlanningError
from offpiste.planning.costs.layers import Hazards
from offpiste.planning.course import Course
from offpiste.runtime.backing_out import BackingOut, BackingOutSettings
from offpiste.runtime.estimator import Given
from offpiste.runtime.follower import TimedPlan
from offpiste.runtime.prediction import Prediction, model_state_after, reachable
from runtime.stream import Held, parametric, straight_drive

SETTINGS = BackingOutSettings(after=3.0, distance=4.0, longest=6.0, attempts=2)
STANDING = Prediction(2.0, np.zeros((250, 6)))
STRAIGHT = Course(np.stack((np.arange(-20.0, 60.0), np.zeros(80)), axis=1), np.full(80, 5.0))


def no_hazard(places):
    return np.zeros(len(places))


def driven_along(backing, places, *, begin=0.0, driven=True, y=0.0, yaw=0.0):
    """Gears while the vehicle is at places [x], one every 0.1 s."""
    gears = []
    for step, x in enumerate(places):
        backing.update(begin + 0.1 * step, np.array((x, y, yaw)), STRAIGHT, driven=driven)
        gears.append(backing.gear)
    return np.array(gears)


@pytest.fixture
def backing():
    return BackingOut(SETTINGS)


def test_a_vehicle_that_moves_or_is_stopped_stays_in_its_gear():
    slowly = driven_along(BackingOut(SETTINGS), 0.02 * np.arange(100))  # 0.2 m/s: 0.6 m in 3 s
    assert (slowly == 1).all()
    assert (driven_along(BackingOut(SETTINGS), np.zeros(100), driven=False) == 1).all()
    assert (driven_along(BackingOut(BackingOutSettings(attempts=0)), np.zeros(1000)) == 1).all()


def test_it_backs_out_after_the_time_and_as_far_as_set(backing):
    gears = driven_along(backing, np.zeros(40))
    assert (gears[:31] == 1).all(), "3 s are not over"
    assert (gears[31:] == -1).all()
    gears = driven_along(backing, -0.1 * np.arange(60), begin=4.0)
    assert (gears[:41] == -1).all()
    assert (gears[41:] == 1).all()


def test_backing_out_that_does_not_move_it_ends_and_is_given_up(backing):
    gears = []
    for step in range(300):
        if backing.update(0.1 * step, np.zeros(3), STRAIGHT, driven=True):
            backing.choose_side(np.zeros(2), STRAIGHT, no_hazard)
        gears.append(backing.gear)
    changes = np.flatnonzero(np.diff(gears)) + 1
    # 3 s stuck, 6 s in reverse, twice; 3 s more, and it gives up.
    np.testing.assert_allclose(0.1 * changes, [3.1, 9.2, 12.3, 18.4], atol=0.15)
    driven_along(backing, np.zeros(100), begin=40.0)
    assert backing.gave_up, "it stands where it stood"
    assert (driven_along(backing, np.full(20, 1.0), begin=50.0) == 1).all(), "something has moved it"
    assert not backing.gave_up


def test_either_of_two_ways_is_left_beside_a_place(backing):
    parted = replace(STRAIGHT, alternative=STRAIGHT.path + np.array((0.0, 9.0)))
    backing.choose_side(np.array((10.0, 9.0)), parted, lambda places: (places[:, 1] > 9.0).astype(float))
    passing = backing.course(parted)
    np.testing.assert_array_equal(passing.path, STRAIGHT.path)
    np.testing.assert_allclose(passing.alternative[30], (10.0, 9.0 - SETTINGS.aside))


@pytest.mark.parametrize("event", ["clock", "jump", "forget"])
def test_a_clock_that_goes_back_a_jump_of_the_pose_and_forget_begin_anew(backing, event):
    assert driven_along(backing, np.zeros(40), begin=100.0)[-1] == -1
    backing.choose_side(np.zeros(2), STRAIGHT, no_hazard)
    driven_along(backing, np.full(2, 2.5), begin=104.0)
    assert backing.places, "25 m/s is no jump"
    if event == "forget":
        backing.forget()
    driven_along(backing, np.full(1, 12.0 if event == "jump" else 2.5), begin=0.0 if event == "clock" else 104.2)
    assert not backing.places
    assert (backing.leg, backing.gear, backing.away) == (0, 1, False)


def test_in_reverse_it_drives_straight_back_over_what_may_be_a_bush(backing):
    assert backing.course(STRAIGHT) is STRAIGHT
    assert backing.hazards(Hazards()) == Hazards()
    driven_along(backing, np.full(40, 1.0), y=2.0, yaw=np.pi / 2)
    assert backing.hazards(Hazards()) == Hazards(low=SETTINGS.obstacles, tall=SETTINGS.tall)
    back = backing.course(STRAIGHT)
    assert (back.speed == -SETTINGS.speed).all()
    assert (backing.course(replace(STRAIGHT, speed=np.full(80, 3.0))).speed == -3.0).all()
    np.testing.assert_allclose(back.path[:, 0], 1.0, atol=1e-9)
    assert back.path[0, 1] < 2.0 - SETTINGS.distance
    assert back.path[-1, 1] > 2.0


def test_slowly_and_over_bushes_until_it_is_back_on_its_course(backing):
    driven_along(backing, np.zeros(40), y=9.0)
    assert (driven_along(backing, -0.2 * np.arange(30), begin=4.0, y=9.0)[-5:] == 1).all()
    assert (backing.course(STRAIGHT).speed == SETTINGS.slow).all()
    assert backing.hazards(Hazards()).low < 1
    driven_along(backing, np.zeros(1), begin=8.0, y=1.5, yaw=1.2)
    assert backing.away, "near it, and across it"
    driven_along(backing, np.zeros(1), begin=8.1, y=1.5, yaw=0.9)
    assert backing.course(STRAIGHT) is STRAIGHT
    assert backing.hazards(Hazards()) == Hazards()


def test_time_at_which_it_is_stopped_or_not_seen_ends_no_leg(backing):
    driven_along(backing, np.zeros(40))
    driven_along(backing, np.zeros(200), begin=4.0, driven=False)
    assert backing.leg == 1, "stopped by a fault"
    driven_along(backing, np.zeros(1), begin=60.0)
    assert backing.leg == 1, "not seen for long"
    driven_along(backing, np.zeros(70), begin=60.1)
    assert backing.leg == 0


@pytest.mark.parametrize("yaw", [2.5, -2.5])
def test_against_its_course_it_turns_round_in_legs(backing, yaw):
    gears, x, y, time = [], 0.0, 0.0, 4.0
    driven_along(backing, np.zeros(40), yaw=yaw)
    while backing.leg and time < 60.0:  # a vehicle that follows the courses exactly, 1 m/s
        path = backing.course(STRAIGHT).path
        step = np.diff(path, axis=0)
        length, heading = np.linalg.norm(step, axis=1), np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
        assert np.abs(np.diff(heading) / length[1:]).max() < 1.01 / SETTINGS.radius
        at = int(np.argmin(np.hypot(path[:-1, 0] - x, path[:-1, 1] - y)))
        yaw = float(heading[min(max(at, 1), len(heading) - 1) - (backing.gear < 0)])
        x, y, time = x + 0.1 * backing.gear * np.cos(yaw), y + 0.1 * backing.gear * np.sin(yaw), time + 0.1
        backing.update(time, np.array((x, y, yaw)), STRAIGHT, driven=True)
        gears.append(backing.gear)
    assert abs(np.angle(np.exp(1j * yaw))) < SETTINGS.along + 0.1
    assert gears[0] == -1
    assert 1 in gears, "it needs a leg forwards"
    assert backing.gear == 1


def test_turning_round_ends_after_the_legs(backing):
    driven_along(backing, np.zeros(40), yaw=3.0)
    legs = {backing.leg}
    for step in range(600):
        backing.update(4.0 + 0.1 * step, np.array((0.0, 0.0, 3.0)), STRAIGHT, driven=True)
        legs.add(backing.leg)
        if not backing.leg:
            break
    assert legs == set(range(SETTINGS.legs + 1))


@pytest.mark.parametrize("better", [1, -1])
def test_the_place_is_passed_where_the_ground_is_better_and_the_next_time_on_the_other_side(backing, better):
    place = np.array((10.0, 0.5))
    backing.choose_side(place, STRAIGHT, lambda places: (better * places[:, 1] < 0).astype(float))
    for times, side in enumerate((better, -better)):
        path = backing.course(STRAIGHT).path
        assert path[30, 1] == pytest.approx(0.5 + side * SETTINGS.aside), "beside the place"
        near = np.abs(STRAIGHT.path[:, 0] - 10.0) < SETTINGS.reach
        np.testing.assert_allclose(path[~near], STRAIGHT.path[~near], atol=1e-12)
        np.testing.assert_array_equal(path[:, 0], STRAIGHT.path[:, 0])
        assert [one.times for one in backing.places] == [times + 1]
        backing.choose_side(place, STRAIGHT, no_hazard)


def test_a_course_that_leads_past_a_place_stays_and_bends_are_left_at_right_angles():
    past, left = BackingOut(SETTINGS), BackingOut(SETTINGS)
    past.choose_side(np.array((10.0, 3.0)), STRAIGHT, no_hazard)
    np.testing.assert_array_equal(past.course(STRAIGHT).path, STRAIGHT.path, "3 m aside")
    angle = np.linspace(0, np.pi, 200)
    bend = Course(15 * np.stack((np.cos(angle), np.sin(angle)), axis=1), np.full(200, 5.0))
    left.choose_side(np.array((0.0, 15.0)), bend, lambda places: (places[:, 1] > 15.0).astype(float))
    np.testing.assert_allclose(left.course(bend).path[100], (0.0, 15 - SETTINGS.aside), atol=0.15)


@pytest.mark.parametrize(("name", "value"), [("after", 0.0), ("slow", float("nan")), ("attempts", -1)])
def test_settings_that_are_not_positive_are_refused(name, value):
    with pytest.raises(PlanningError, match=name):
        BackingOutSettings(**{name: value})


def geared_drive(truth=None, **changed):
    """A drive of a model that knows a gear, in a vehicle that moves so or as `truth`."""
    truth, state = truth or parametric("gear"), changed.pop("state", (0.0,) * 6)
    return straight_drive(dynamics=parametric("gear"), wanted=3.0, stream={"truth": truth, "state": state}, **changed)


class Mud(Held):
    """Holds a geared vehicle over 2 m from some x on unless it reverses."""

    def __init__(self, begin=6.0):
        self.free, self.gears, self.begin = parametric("gear"), [], begin

    def step(self, model_state, command, terrain):
        self.gears.append(float(command[0, 3]))
        x, y = model_state.state[0, :2].tolist()
        if self.begin < x < self.begin + 2.0 and abs(y) < 1.0 and self.gears[-1] > 0:
            held = model_state.state.clone()
            held[:, 3:] = 0.0
            return replace(model_state, state=held)
        return self.free.step(model_state, command, terrain)


def test_a_stuck_vehicle_backs_out_and_goes_around():
    stream = geared_drive(Mud(), backing_out=BackingOutSettings(after=2.0)).run(10.0)
    while stream.states[-1][0] < 9.5 and len(stream.states) < 950:
        stream.run(0.5)
    x, y = np.array([state[:2] for state in stream.states]).T
    stuck = int(np.flatnonzero(x > 6.0)[0])
    behind = stuck + int(np.argmin(x[stuck:]))
    assert ("driving", "backing out") in stream.modes()
    assert x[behind] < x[stuck] - 3.0, "it reverses out of the mud"
    assert x[-1] > 9.0, "and passes it"
    assert np.abs(y[behind:][np.abs(x[behind:] - 7.0) < 1.0]).min() > 1.0, "beside it"
    (changes,) = np.nonzero(np.diff(stream.truth.gears))
    assert len(changes) == 2
    assert all(abs(stream.states[row + 1][3]) < 0.3 for row in changes), "gears are changed at a standstill"


def test_far_behind_its_position_it_is_back_on_its_course():
    far = BackingOutSettings(after=0.6, distance=10.0)
    stream = geared_drive(Mud(16.0), state=(14.0, 0, 0, 0, 0, 0), backing_out=far)
    backing, reversing = stream.runtime._maker._backing_out, []
    while not (reversing and not backing.leg) and len(stream.states) < 1000:
        stream.run(0.1)
        reversing += [backing.leg] * (backing.leg > 0)
    stream.run(0.2)
    assert stream.runtime.course_tracker.progress - stream.states[-1][0] > 9.0
    assert not backing.away
    assert stream.runtime.follower.tracker.stretch().path[0, 0] > stream.states[-1][0] + 2.0, "of any other vehicle"


def test_a_plan_in_another_gear_starts_where_the_vehicle_then_is():
    # Until a plan acts the vehicle is driven in the gear before it.
    stream = geared_drive(latency=0.3).run(1.5)
    stream.runtime._maker._backing_out.update = lambda *_, **__: False
    stream.runtime._maker._backing_out.gear = -1.0
    stream.run(0.5)
    plan = next(plan for plan in stream.runtime.predictions if plan.time > 1.79)
    met = stream.states[round(plan.time / DT)]
    assert met[3] > 1.0
    np.testing.assert_allclose(plan.state[0, [0, 3]], (met[0] + DT * met[3], met[3]), atol=0.2)


@pytest.mark.parametrize("mapped", [True, False])
def test_a_vehicle_that_does_not_get_free_gives_up_also_without_a_map_of_the_place(mapped, monkeypatch):
    stream = geared_drive(Held(), backing_out=BackingOutSettings(after=0.6, longest=0.6, attempts=1))
    maker, found = stream.runtime._maker, []

    def empty_at_first(*given):
        layers = reachable(*given)
        found.append(maker._found_stuck is not None)
        newly = found[-1] and found[-2:-1] != [True]
        return layers if mapped or not newly else replace(layers, known=np.zeros_like(layers.known))

    monkeypatch.setattr("offpiste.runtime.plan_maker.reachable", empty_at_first)
    stream.run(4.0)
    assert any(found)
    assert stream.modes()[-1] == ("stopped", "stuck")
    assert stream.controls[-1].command[1] == pytest.approx(0.5)


def test_a_model_without_a_gear_never_reverses():
    stream = straight_drive(stream={"truth": Held()}, backing_out=BackingOutSettings(after=0.4, longest=0.4)).run(2.0)
    assert all(controls.gear == 1.0 for controls in stream.controls)
    assert ("stopped", "stuck") not in stream.modes()


def test_committed_controls_brake_until_the_gear_is_engaged():
    stream = geared_drive().run(2.0)
    follower = stream.runtime.follower
    follower.schedule.add(TimedPlan(2.0, 2.0, torch.full((250, 3), 0.25), STANDING, -1.0))
    committed = follower.committed(2.0, 2.2, stream.runtime._track.rows(2.0 - DT))
    np.testing.assert_allclose(committed[:, :2], np.tile((0.0, 0.5), (10, 1)))


def test_plans_start_from_the_control_and_gear_of_another_driver(monkeypatch):
    gears = []

    def noticed(*given):
        gears.append(given[-1].gear)
        return model_state_after(*given)

    monkeypatch.setattr("offpiste.runtime.plan_maker.model_state_after", noticed)
    stream = geared_drive().run(1.0)
    follower, given = stream.runtime.follower, np.array((0.0, 0.6, -0.5))
    assert follower.engaged == 1.0
    follower.driver = Given(given, -1.0)
    commanded = stream.runtime.step(1.0)
    assert (gears[-2], gears[-1]) == (1.0, -1.0)
    follower.stopping = True  # ours, which they do not make
    rows = stream.runtime._track.rows(1.0)
    np.testing.assert_array_equal(follower.committed(1.0, 1.1, rows), np.tile(given, (5, 1)))
    assert (rows.gear[-1], follower.engaged) == (-1.0, -1.0)
    assert commanded.gear == follower.gear == 1.0
    follower.driver = Given()
    assert follower.committed(1.0, 1.1, rows)[0].tolist() != given.tolist()
