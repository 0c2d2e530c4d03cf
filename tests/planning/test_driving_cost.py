"""Cost of driving along trajectories, worked out by hand."""

import itertools
import math
from dataclasses import replace

import pytest
import torch

from offpiste.core.conventions import DT, GRAVITY
from offpiste.core.state import Trajectory
from offpiste.planning.costs.layers import Hazards
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.driving_cost import driving_cost, driving_terms
from planning_maps import layers, situation

STEPS = 50


def moving(vx=5.0, vy=0.0, yaw=0.0, yaw_rate=0.0, y=0.0, x=0.0):
    """Constant velocities from x, y."""
    t = DT * torch.arange(1, STEPS + 1)
    cos, sin = math.cos(yaw), math.sin(yaw)
    columns = (x + (cos * vx - sin * vy) * t, y + (sin * vx + cos * vy) * t, yaw, vx, vy, yaw_rate)
    state = torch.stack([torch.as_tensor(c, dtype=torch.float32).expand(STEPS) for c in columns], dim=-1)[None]
    return Trajectory(state, torch.zeros(1, STEPS, 4))


def terms_of(trajectory, at=None, weights=None, controls=None):
    controls = torch.zeros(1, STEPS, 3) if controls is None else controls
    return driving_terms(trajectory, controls, at or situation(), weights or CostWeights())


def test_on_the_path_and_beside_it_too_slow():
    assert driving_cost(moving(), torch.zeros(1, STEPS, 3), situation(), CostWeights()).item() == pytest.approx(
        0, abs=1e-5
    )
    found = terms_of(moving(vx=3.0, y=2.0), weights=CostWeights(path=0.5, speed=2.0))
    torch.testing.assert_close(found["path"], torch.full((1, STEPS), 0.5 * 4.0))
    torch.testing.assert_close(found["speed"], torch.full((1, STEPS), 2.0 * 4.0))
    total = driving_cost(moving(vx=3.0, y=2.0), torch.zeros(1, STEPS, 3), situation(), CostWeights(path=0.5, speed=2.0))
    assert total.item() == pytest.approx(STEPS * DT * 10, rel=1e-5)


def test_a_bend_that_would_roll_the_vehicle_over():
    for yaw_rate, rolls in ((1.3, False), (1.5, True)):  # 5 m/s: 0.66 and 0.76 g
        found = terms_of(moving(yaw_rate=yaw_rate), weights=CostWeights(lateral_limit=0.7, rollover=1000.0))
        wanted = 1000 * (1 + 5 * yaw_rate / GRAVITY - 0.7) if rolls else 0.0
        torch.testing.assert_close(found["rollover"], torch.full((1, STEPS), wanted), rtol=1e-4, atol=1e-6)


def test_a_side_slope_that_would_roll_the_vehicle_over_from_either_side():
    at = situation(layers(plane=(0.0, 0.8)))
    for yaw, rolls in ((0.0, True), (math.pi, True), (math.pi / 2, False)):
        found = terms_of(moving(yaw=yaw, vx=0.0), at, CostWeights(lateral_limit=0.7))
        assert bool((found["rollover"] > 0).all()) is rolls
        assert bool((found["rollover"] > 0).any()) is rolls


def test_the_first_step_knows_the_lateral_speed_before_it():
    at = situation(state=(0.0, 0, 0, 5, -0.2, 0))  # to 0 within a step: 10 m/s^2
    found = terms_of(moving(), at, CostWeights(lateral_limit=0.7))["rollover"][0]
    assert found[0] > 0
    assert (found[1:] == 0).all()


def test_an_obstacle_costs_each_wheel_that_it_is_under():
    ground = layers()
    ground.obstacle_height[40, 50] = 1.0  # x = 5, y = 0
    ground.obstacle_height[42, 50] = 1.0  # x = 5, y = 1
    at = situation(ground, hazards=Hazards(obstacle=100.0, margin=0.1))
    standing = terms_of(moving(vx=0.0, x=3.9), at)
    torch.testing.assert_close(standing["hazard"], torch.full((1, STEPS), 25.0))  # only the front left wheel
    assert (terms_of(moving(vx=0.0, x=-3.9), at)["hazard"] == 0).all()


def test_off_the_map_and_on_cells_of_which_nothing_is_known():
    ground = layers()
    ground.known[:, :40] = False
    at = situation(ground, hazards=Hazards(unknown=5.0))
    assert (terms_of(moving(vx=0.0, x=10.0), at)["hazard"] == 0).all()
    assert (terms_of(moving(vx=0.0, x=-10.0), at)["hazard"] == 5).all()
    assert (terms_of(moving(vx=0.0, x=100.0), at)["hazard"] == 5).all()
    assert (terms_of(moving(vx=0.0), at)["hazard"] == 2.5).all()


def test_rough_ground_limits_the_speed():
    ground = layers()
    ground.roughness[:] = 0.2
    at = situation(ground)
    limit = at.costs.layers[0, 0, 1].item()
    assert 0 < limit < 5
    found = terms_of(moving(), at, CostWeights(overspeed=3.0))["overspeed"]
    torch.testing.assert_close(found, torch.full((1, STEPS), 3 * (5 - limit) ** 2))


def test_effort_and_jerk_start_from_the_last_control():
    at = replace(situation(), control=torch.tensor([0.1, 0.0, 0.0]))
    controls = torch.tensor([0.3, 0.0, -0.5]).expand(1, STEPS, 3)
    found = terms_of(moving(), at, CostWeights(effort=(1.0, 1.0, 2.0), jerk=(0.1, 1.0, 0.1)), controls)
    torch.testing.assert_close(found["effort"], torch.full((1, STEPS), 0.09 + 0.5))
    assert found["jerk"][0, 0].item() == pytest.approx(0.1 * 10**2 + 0.1 * 25**2, rel=1e-5)
    assert (found["jerk"][0, 1:] == 0).all()


def test_a_state_that_is_not_finite_has_no_finite_cost():
    for channel, value in itertools.product(range(6), (math.nan, math.inf)):
        trajectory = moving()
        trajectory.state[0, 7, channel] = value
        assert not driving_cost(trajectory, torch.zeros(1, STEPS, 3), situation(), CostWeights()).isfinite().any()


def test_the_frame_of_the_trajectories_may_be_shifted():
    ground = layers()
    ground.obstacle_height[:30] = 1.0
    at, moved = situation(ground), moving(y=-3.0)
    there = Trajectory(moved.state - torch.tensor([7.0, 9.0, 0, 0, 0, 0]), moved.actuators)
    shifted = replace(at, offset=torch.tensor([7.0, 9.0], dtype=torch.float64))
    controls = torch.zeros(1, STEPS, 3)
    wanted, found = (
        driving_cost(moved, controls, at, CostWeights()),
        driving_cost(there, controls, shifted, CostWeights()),
    )
    torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-4)
