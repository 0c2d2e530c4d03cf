"""Lags of brake, steering and engine against their closed forms."""

import math
from dataclasses import replace

import pytest
import torch

from dynamics.test_bicycle import SCALARS
from factories import COMMANDED, VEHICLE, Situation, gradients_agree, unsettled
from offpiste.core.conventions import DT
from offpiste.dynamics.actuator_lags import apply_release, second_order
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.kernels import layout


def run(model: Actuators, actuators: list[float], control: list[float], steps: int, vx: float = 0.0) -> torch.Tensor:
    """Actuators after each step under a constant command, with the untrained (zero) residuals."""
    now, lags = torch.tensor([actuators]).double(), model.constants()
    memory = torch.zeros(1, model.recurrent_size).double()
    rows = []
    for _ in range(steps):
        now, _ = model.step(lags, now, torch.tensor([control]).double(), torch.tensor([vx]).double(), memory)
        rows.append(now[0])
    return torch.stack(rows).detach()


def test_the_brake_applies_and_releases_at_different_rates_without_overshoot():
    c = {"apply": 5.0, "release": 2.0}
    for pressure, command, change in ((0.25, 0.75, 2.5), (0.75, 0.25, -1.0), (0.5, 0.5, 0.0)):
        assert apply_release((pressure,), command, 0.0, c, SCALARS)[0] == pytest.approx(change)
    pressure = run(Actuators(VEHICLE).double(), [0.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0], 50)[:, 0]
    wanted = 1 - (1 - 8.0 * DT) ** torch.arange(1, 51).double()
    torch.testing.assert_close(pressure, wanted, atol=1e-6, rtol=0)


def test_steering_settles_at_gain_times_command_as_a_second_order_lag():
    model = Actuators(VEHICLE).double()
    steer = run(model, [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, -0.6], 150)[:, 1]
    assert steer[-1] == pytest.approx(-0.3, abs=1e-3)
    # 8 rad/s with damping 0.8: overshoot exp(-pi 0.8 / 0.6) = 1.5 %, a little more under Euler.
    assert -steer.min() / 0.3 - 1 == pytest.approx(0.015, abs=0.02)
    rate, acceleration = second_order((0.1, 0.2), 0.6, 0.0, model.constants()["steer"], SCALARS)
    assert rate == 0.2
    assert acceleration.item() == pytest.approx(64 * 0.2 - 2 * 0.8 * 8 * 0.2, rel=1e-5)


def test_the_engine_settles_at_a_speed_given_by_throttle_and_vehicle_speed():
    revolutions = run(Actuators(VEHICLE).double(), [0.0, 0.0, 0.0, 2.0], [0.5, 0.0, 0.0], 300, vx=-4.0)[:, 3]
    assert revolutions[-1] == pytest.approx(1.0 + 3 * 0.5 + 0.1 * 4, abs=1e-3)


@pytest.mark.parametrize("end", [-20.0, 20.0])
def test_lags_are_stable_at_both_ends_of_all_ranges(end):
    model = Actuators(VEHICLE).double()
    for i, name in enumerate(layout.LAG_CONSTANTS):
        model.raw.data[i] = end if name != "steer_damping" else -end
    rows = run(model, [0.3, 0.2, 1.0, 2.0], [0.5, 0.5, 0.5], 400, vx=5.0)
    assert (rows[200:].abs() < 20).all()
    assert (rows[-1] - rows[-2]).abs().max() <= (rows[0] - rows[1]).abs().max()


def test_gradients_equal_finite_differences():
    model = unsettled(Actuators(VEHICLE).double())
    situation = Situation(batch=2)

    def run(model: Actuators) -> torch.Tensor:
        now, memory = situation.actuators, model.start(situation.history)
        for control in situation.controls.unbind(1)[:4]:
            now, memory = model.step(model.constants(), now, control, situation.state[:, 3], memory)
        return now

    assert gradients_agree(model, run)


def test_absent_actuators_and_those_without_a_command_stay_unchanged():
    now = torch.full((1, 4), torch.nan)
    model = Actuators(COMMANDED)
    assert model.recurrent_size == 0
    after, _ = model.step(model.constants(), now, torch.full((1, 3), 0.5), torch.ones(1), torch.zeros(1, 0))
    assert after.isnan().all()
    model = Actuators(replace(VEHICLE, control=("throttle",))).double()
    rows = run(model, [0.3, 0.2, 0.1, 2.0], [0.5, math.nan, math.nan], 10)
    assert rows[-1, :3].tolist() == pytest.approx([0.3, 0.2, 0.1])
    assert rows[-1, 3] != 2.0
