"""The baselines against their closed forms."""

import math
from dataclasses import replace

import pytest
import torch

from factories import COMMANDED, Situation, flat, unsettled
from offpiste.core.conventions import DT
from offpiste.core.state import ModelState, RecordedTerrain
from offpiste.dynamics import ConstantMotion, Kinematic, Recurrent, rollout


def drive(model, state: list[float], control: list[float], steps: int = 100) -> torch.Tensor:
    """States of one vehicle under a constant command, on flat ground."""
    nothing = torch.zeros(1, 0).double()
    model_state = ModelState(torch.tensor([state]).double(), torch.full((1, 4), math.nan).double(), nothing, nothing)
    controls = torch.tensor(control).double().expand(1, steps, 3)
    return rollout(model, model_state, controls, RecordedTerrain(flat(1, steps))).state[0]


def test_constant_motion_drives_a_circle():
    states = drive(ConstantMotion(COMMANDED), [0, 0, 0, 5, 0, 0.5], [1, 1, 1])
    assert (states[:, 3:] == torch.tensor([5.0, 0.0, 0.5])).all()
    assert states[-1, 2] == pytest.approx(1.0)
    # Radius 10 m, 1 rad; forward Euler is off by half a step.
    assert states[-1, 0] == pytest.approx(10 * math.sin(1), abs=5 * DT)
    assert states[-1, 1] == pytest.approx(10 * (1 - math.cos(1)), abs=5 * DT)


@pytest.mark.parametrize("vx", [5.0, -5.0])
def test_the_kinematic_bicycle_turns_by_its_geometry(vx):
    states = drive(Kinematic(COMMANDED).double(), [0, 0, 0, vx, 0, 0], [1, 1, 0.5])
    assert states[-1, 5] == pytest.approx(vx * math.tan(0.2) / 2.2)
    assert states[-1, 2] == pytest.approx(2 * vx * math.tan(0.2) / 2.2)
    assert states[-1, 3] == vx


@pytest.mark.parametrize("rear_axle", [0.0, 1.1])
def test_the_kinematic_bicycles_rear_axle_does_not_slip(rear_axle):
    model = Kinematic(replace(COMMANDED, rear_axle=rear_axle)).double()
    states = drive(model, [0, 0, 0, 5, 1.0, 0.3], [0, 0, 0.5])
    torch.testing.assert_close(states[:, 4], rear_axle * states[:, 5])
    yaw = states[:, 2]
    axle = states[:, :2] - rear_axle * torch.stack((yaw.cos(), yaw.sin()), dim=-1)
    moved, heading = axle.diff(dim=0), (yaw[1:] + yaw[:-1]) / 2
    sideways = moved[:, 1] * heading.cos() - moved[:, 0] * heading.sin()
    assert sideways.abs().max() < 0.01 * moved.norm(dim=-1).min()


def test_lateral_velocity_moves_to_the_left_of_the_heading():
    states = drive(ConstantMotion(COMMANDED), [0, 0, math.pi / 2, 0, 1, 0], [0, 0, 0])
    assert states[-1, :2].tolist() == pytest.approx([-2.0, 0.0], abs=1e-6)


def test_the_network_without_physics_integrates_its_accelerations():
    model = Recurrent(COMMANDED).double()
    at = Situation(batch=2, steps=3)
    model_state = model.start(at.history, at.state, at.actuators)
    untrained = rollout(model, model_state, at.controls, at.source).state
    torch.testing.assert_close(untrained[:, -1, 3:], at.state[:, 3:])
    model.network.output[-1].bias.data = torch.tensor([1.0, -2.0, 0.5]).double()
    moved = rollout(model, model_state, at.controls, at.source).state
    gained = torch.tensor([1.0, -2.0, 0.5]).double() * 3 * DT
    torch.testing.assert_close(moved[:, -1, 3:], at.state[:, 3:] + gained)


def test_the_network_without_physics_sees_the_slope_and_the_history():
    model = unsettled(Recurrent(COMMANDED).double())
    at, other = Situation(batch=1, seed=1), Situation(batch=1, seed=2)

    def predict(history, source):
        return rollout(model, model.start(history, at.state, at.actuators), at.controls, source).state

    reference = predict(at.history, at.source)
    assert not torch.allclose(reference, predict(at.history, other.source))
    assert not torch.allclose(reference, predict(other.history, at.source))
