"""The parametric bicycle and the hybrid on top of it, driven through the interface."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from factories import COMMANDED, VEHICLE, Situation, coded, flat, ground, unsettled
from offpiste.core.conventions import DT, GRAVITY
from offpiste.core.state import ModelState, RecordedTerrain, Terrain
from offpiste.dynamics import Hybrid, Parametric, rollout
from offpiste.dynamics.bicycle import _RANGES, Constants


def run(model, state: Tensor, controls: Tensor, terrain: Terrain) -> Tensor:
    """States of vehicles whose log has commands only."""
    nothing = state.new_zeros(len(state), 0)
    model_state = ModelState(state, state.new_full((len(state), 4), math.nan), nothing, nothing)
    return rollout(model, model_state, controls, RecordedTerrain(terrain)).state


def constant(steps: int, *control: float) -> Tensor:
    return torch.tensor(control, dtype=torch.float64).expand(1, steps, 3)


def climbing(steps: int, slope: float, yaw: float) -> Terrain:
    """A plane that rises along a heading."""
    x, y = (torch.full((1, steps, 4), slope * turn, dtype=torch.float64) for turn in (math.cos(yaw), math.sin(yaw)))
    return ground(x, y)


def at_rest(yaw: float = 0.0, vx: float = 0.0) -> Tensor:
    return torch.tensor([[0.0, 0.0, yaw, vx, 0.0, 0.0]], dtype=torch.float64)


@pytest.mark.parametrize("vehicle", [VEHICLE, COMMANDED])
@pytest.mark.parametrize("codes", [0, 3])
def test_an_untrained_hybrid_is_its_bicycle(vehicle, codes):
    hybrid, parametric = coded(vehicle, codes).double(), Parametric(vehicle).double()
    at = Situation(codes=codes)
    found, wanted = (
        rollout(m, m.start(at.history, at.state, at.actuators), at.controls, at.source) for m in (hybrid, parametric)
    )
    torch.testing.assert_close(found.state, wanted.state)


def test_one_unit_of_compensation_is_one_unit_of_acceleration():
    model = Hybrid(COMMANDED).double()
    at = Situation(batch=1, steps=1)
    at.controls[..., 2] = 0
    state = at_rest(vx=5.0)
    model_state = model.start(at.history, state, at.actuators)
    before = rollout(model, model_state, at.controls, RecordedTerrain(flat(1, 1))).state[0, 0]
    wanted = {0: (1, 0, 0), 1: (0, 1, 0), 2: (0, 1, 0), 3: (0, 0, 1)}
    for force, gain in wanted.items():
        model.compensator.output[-1].bias.data = torch.eye(4).double()[force]
        after = rollout(model, model_state, at.controls, RecordedTerrain(flat(1, 1))).state[0, 0]
        torch.testing.assert_close((after - before)[3:] / DT, torch.tensor(gain).double(), atol=1e-6, rtol=0)


def test_codes_history_and_hidden_state_change_the_compensation():
    model = unsettled(coded(VEHICLE, 3).double())
    at, other = Situation(batch=1, codes=3, seed=1), Situation(batch=1, codes=3, seed=2)

    def predict(history, terrain):
        model_state = model.start(history, at.state, at.actuators)
        return rollout(model, model_state, at.controls, RecordedTerrain(terrain)).state

    mine, others = at.source.terrain, other.source.terrain
    reference = predict(at.history, mine)
    assert not torch.equal(reference, predict(at.history, replace(mine, latent=others.latent)))
    assert not torch.equal(reference, predict(other.history, mine))


@pytest.mark.parametrize("yaw", [0.0, 2.0, -1.0])
def test_climbing_slows_and_descending_speeds_up(yaw):
    model, start = Parametric(COMMANDED).double(), at_rest(yaw, vx=5.0)
    up, level, down = (run(model, start, constant(50, 0, 0, 0), climbing(50, s, yaw))[0, -1, 3] for s in (0.2, 0, -0.2))
    assert up < level < down
    # Gravity alone makes the difference: g sin(atan 0.2) for 1 s, each way.
    assert (level - up).item() == pytest.approx(GRAVITY * math.sin(math.atan(0.2)), rel=0.05)


def test_a_bank_pushes_downhill_on_either_heading():
    model = Parametric(COMMANDED).double()
    falls_to_minus_y = climbing(25, 0.2, math.pi / 2)
    for yaw, sign in ((0.0, -1), (math.pi, 1)):
        states = run(model, at_rest(yaw, vx=5.0), constant(25, 0, 0, 0), falls_to_minus_y)
        assert sign * states[0, -1, 4] > 0.01
        assert states[0, -1, 1] < 0


@pytest.mark.parametrize("steer", [-1.0, 1.0])
def test_parked_with_wheels_turned_and_brakes_on_it_stays(steer):
    states = run(Parametric(COMMANDED).double(), at_rest(), constant(250, 0, 1, steer), flat(1, 250))
    assert states[0, :, :2].norm(dim=-1).max() < 1e-3


def test_strong_brakes_hold_it_on_a_slope_but_for_a_creep():
    """The regularised brake holds by creeping: v = 0.25 m/s atanh(gravity over braking)."""
    model = Parametric(COMMANDED).double()
    model.bicycle.raw.data[list(_RANGES).index("brake_1")] = 2.0
    states = run(model, at_rest(), constant(250, 0, 1, 0), climbing(250, 0.1, 0.0))
    assert -0.05 < states[0, -1, 3] < 0
    assert abs(states[0, -1, 3] - states[0, -50, 3]) < 1e-6


@pytest.mark.parametrize("vx", [6.0, -6.0])
def test_braking_stops_it_without_turning_back(vx):
    states = run(Parametric(COMMANDED).double(), at_rest(vx=vx), constant(250, 0, 1, 0.0), flat(1, 250))[0, :, 3]
    assert (states.abs().diff() <= 0).all()
    assert (states.abs() < 1e-3)[-1]
    assert states[-1] * vx >= -1e-9


def test_left_and_right_are_alike():
    model, at = unsettled(Parametric(COMMANDED).double()), Situation(steps=30).filled(COMMANDED, math.nan)
    flip = torch.tensor([1, -1, -1, 1, -1, -1]).double()
    normal = at.source.terrain.normal
    mirrored = replace(at.source.terrain, normal=normal * torch.tensor([1, -1, 1]).double())
    one = run(model, at.state, at.controls, at.source.terrain)
    other = run(model, at.state * flip, at.controls * torch.tensor([1, 1, -1]).double(), mirrored)
    torch.testing.assert_close(other, one * flip)


# --- A known bicycle's identifiable combinations, recovered from its own drive ---

TRUTH = {
    "drive_1": 2.5, "drive_bend": 1.8, "engine_1": -0.3, "engine_2": 0.05, "brake_1": 1.2, "brake_2": 1.6,
    "resistance": 0.35, "resistance_slope": 1.5, "rear_peak": 5.0, "rear_shape": 1.2, "rear_stiffness": 3.5,
    "front_peak": 4.0, "front_shape": 1.4, "front_stiffness": 2.5, "rear_length": 0.55, "front_length": 0.4,
    "min_slip_speed": 1.5, "yaw_understeer": 0.75, "yaw_damping": 7.0, "drag_x": 0.012, "drag_y": 0.004,
    "gravity_x": 9.0, "gravity_y": 8.5,
}  # fmt: skip


def known_bicycle() -> Parametric:
    model = Parametric(COMMANDED).double()
    assert list(TRUTH) == list(_RANGES)
    for i, (low, high, _) in enumerate(_RANGES.values()):
        share = (TRUTH[list(TRUTH)[i]] - low) / (high - low)
        model.bicycle.raw.data[i] = math.log(share / (1 - share))
    return model


def exciting_drives(drives: int, steps: int) -> tuple[Tensor, Tensor, Terrain]:
    """Starts, random-walk commands with either pedal, and slopes that vary slowly."""
    generator = torch.Generator().manual_seed(0)

    def walk(*size: int) -> Tensor:
        moves = torch.randn(drives, steps, *size, generator=generator, dtype=torch.float64)
        start = torch.randn(drives, 1, *size, generator=generator, dtype=torch.float64)
        return start + 0.15 * moves.cumsum(dim=1)

    pedal, steer, slope_x, slope_y = walk(), walk(), walk(1), walk(1)
    controls = torch.stack((pedal.clamp(0, 1), (-pedal).clamp(0, 1), torch.tanh(0.8 * steer)), dim=-1)
    start = torch.zeros(drives, 6).double()
    start[:, 3] = 1 + 11 * torch.rand(drives, generator=generator, dtype=torch.float64)
    slopes = (0.1 * slope.expand(-1, -1, 4) for slope in (slope_x, slope_y))
    return start, controls, ground(*slopes)


def identifiable(c: Constants) -> dict[str, float]:
    """Quantities that a drive determines; the constants alone cannot be identified."""

    def drive(throttle: float, speed: float) -> float:
        x = speed / 10
        return 2 * (1 + c.engine_1 * x + c.engine_2 * x * x) * (c.drive_1 * throttle + c.drive_2 * throttle**2) / c.mass

    def braking(brake: float) -> float:
        return 2 * (c.brake_1 * brake + c.brake_2 * brake**2) / c.mass

    def coasting(speed: float) -> float:
        return 2 * c.resistance * math.tanh(c.resistance_slope * speed) / c.mass + c.drag_x * speed * speed

    return {
        "steady yaw gain": c.yaw_gain / c.yaw_damping,
        "yaw damping": c.yaw_damping,
        "drive at 0.3": drive(0.3, 5.0),
        "drive at 0.6": drive(0.6, 5.0),
        "drive at 1.0": drive(1.0, 5.0),
        "braking at 0.5": braking(0.5),
        "braking at 1": braking(1.0),
        "coasting at 3 m/s": coasting(3.0),
        "coasting at 8 m/s": coasting(8.0),
        "front stiffness": c.front_peak * c.front_shape * c.front_stiffness / c.mass,
        "rear stiffness": c.rear_peak * c.rear_shape * c.rear_stiffness / c.mass,
        "gravity along": c.gravity_x,
        "gravity across": c.gravity_y,
    }


def test_identifiable_combinations_are_recovered_from_150_s_of_driving():
    truth, steps, window = known_bicycle(), 150, 15
    start, controls, terrain = exciting_drives(50, steps)
    with torch.no_grad():
        states = run(truth, start, controls, terrain)

    def cut(values: Tensor) -> Tensor:
        return values.unflatten(1, (-1, window)).flatten(0, 1)

    begins = torch.cat((start[:, None], states[:, window - 1 : -1 : window]), dim=1).flatten(0, 1)
    targets, commands = cut(states)[..., 3:], cut(controls)
    grounds = Terrain(cut(terrain.normal), cut(terrain.known), cut(terrain.latent))
    scale = (targets - begins[:, None, 3:]).square().mean(dim=(0, 1))

    model = Parametric(COMMANDED).double()
    epochs = 300
    optimiser = torch.optim.Adam([model.bicycle.raw], lr=0.08)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 0.15, total_steps=epochs)
    for _ in range(epochs):
        predicted = run(model, begins, commands, grounds)[..., 3:]
        loss = ((predicted - targets).square().mean(dim=(0, 1)) / scale).sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()

    wanted, found = (identifiable(Constants(*(float(x.detach()) for x in m.bicycle()))) for m in (truth, model))
    off = {name: found[name] / wanted[name] - 1 for name in wanted}
    assert {name: error for name, error in off.items() if abs(error) > 0.03} == {}
