"""The baselines, the parametric bicycle and the hybrid model, driven through the interface."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from factories import COMMANDED, VEHICLE, Situation, coded, flat, ground, unsettled
from offpiste.core.conventions import DT, GRAVITY
from offpiste.core.state import ModelState, RecordedTerrain, Terrain
from offpiste.dynamics import ConstantMotion, Hybrid, Kinematic, Parametric, Recurrent, rollout
from offpiste.dynamics.bicycle import RANGES, Constants
from offpiste.dynamics.kernels.autograd import rollout_recorded


def run(model, state: Tensor, controls: Tensor, terrain: Terrain | None = None) -> Tensor:
    """States of vehicles whose log has commands only; on flat ground by default; in float32 by kernels."""
    model_state = ModelState(state, state.new_full((len(state), 4), math.nan), state.new_zeros(len(state), 0))
    ground = terrain if terrain is not None else flat(*controls.shape[:2])
    if state.dtype == torch.float32:
        return rollout_recorded(model, model_state, controls, ground).state
    return rollout(model, model_state, controls, RecordedTerrain(ground)).state


def predict(model, at: Situation, *, history=None, terrain: Terrain | None = None) -> Tensor:
    """States of a situation, with another past or ground if given."""
    model_state = model.start(history or at.history, at.state, at.actuators)
    return rollout(model, model_state, at.controls, RecordedTerrain(terrain or at.source.terrain)).state


def constant(steps: int, *control: float) -> Tensor:
    return torch.tensor(control, dtype=torch.float64).expand(1, steps, 3)


def climbing(steps: int, slope: float, yaw: float) -> Terrain:
    """A plane that rises along a heading."""
    x, y = (torch.full((1, steps, 4), slope * turn, dtype=torch.float64) for turn in (math.cos(yaw), math.sin(yaw)))
    return ground(x, y)


def moving(yaw: float = 0.0, vx: float = 0.0, vy: float = 0.0, yaw_rate: float = 0.0) -> Tensor:
    return torch.tensor([[0.0, 0.0, yaw, vx, vy, yaw_rate]], dtype=torch.float64)


def test_constant_motion_follows_a_circle():
    states = run(ConstantMotion(COMMANDED), moving(vx=5, yaw_rate=0.5), constant(100, 1, 1, 1))[0]
    assert (states[:, 3:] == torch.tensor([5.0, 0.0, 0.5])).all()
    # Radius 10 m, 1 rad; forward Euler is off by half a step.
    assert states[-1, :3].tolist() == pytest.approx([10 * math.sin(1), 10 * (1 - math.cos(1)), 1.0], abs=5 * DT)
    sideways = run(ConstantMotion(COMMANDED), moving(math.pi / 2, vy=1.0), constant(100, 0, 0, 0))[0]
    assert sideways[-1, :2].tolist() == pytest.approx([-2.0, 0.0], abs=1e-6)


@pytest.mark.parametrize(("vx", "rear_axle"), [(5.0, 0.0), (-5.0, 1.1)])
def test_the_kinematic_bicycle_turns_by_its_geometry_and_its_rear_axle_does_not_slip(vx, rear_axle):
    model = Kinematic(replace(COMMANDED, rear_axle=rear_axle)).double()
    states = run(model, moving(vx=vx, vy=1.0, yaw_rate=0.3), constant(100, 0, 0, 0.5))[0]
    assert states[-1, 5] == pytest.approx(vx * math.tan(0.2) / 2.2)
    assert states[-1, 2] == pytest.approx(2 * vx * math.tan(0.2) / 2.2)
    torch.testing.assert_close(states[:, 4], rear_axle * states[:, 5])
    yaw = states[:, 2]
    axle = states[:, :2] - rear_axle * torch.stack((yaw.cos(), yaw.sin()), dim=-1)
    moved, heading = axle.diff(dim=0), (yaw[1:] + yaw[:-1]) / 2
    sideways = moved[:, 1] * heading.cos() - moved[:, 0] * heading.sin()
    assert sideways.abs().max() < 0.01 * moved.norm(dim=-1).min()


def test_the_network_without_physics_integrates_its_accelerations():
    model, at = Recurrent(COMMANDED).double(), Situation(batch=2, steps=3)
    torch.testing.assert_close(predict(model, at)[:, -1, 3:], at.state[:, 3:])
    model.network.output[-1].bias.data = torch.tensor([1.0, -2.0, 0.5]).double()
    gained = torch.tensor([1.0, -2.0, 0.5]).double() * 3 * DT
    torch.testing.assert_close(predict(model, at)[:, -1, 3:], at.state[:, 3:] + gained)


@pytest.mark.parametrize("vehicle", [VEHICLE, COMMANDED])
@pytest.mark.parametrize("codes", [0, 3])
def test_an_untrained_hybrid_equals_its_bicycle(vehicle, codes):
    at = Situation(codes=codes)
    torch.testing.assert_close(predict(coded(vehicle, codes).double(), at), predict(Parametric(vehicle).double(), at))


def test_a_unit_of_correction_is_a_unit_of_acceleration():
    model = Hybrid(COMMANDED).double()
    at = Situation(batch=1, steps=1)
    at.controls[..., 2], at.state = 0, moving(vx=5.0)
    before = predict(model, at, terrain=flat(1, 1))[0, 0]
    wanted = {0: (1, 0, 0), 1: (0, 1, 0), 2: (0, 1, 0), 3: (0, 0, 1)}
    for force, gain in wanted.items():
        model.compensator.output[-1].bias.data = torch.eye(4).double()[force]
        after = predict(model, at, terrain=flat(1, 1))[0, 0]
        torch.testing.assert_close((after - before)[3:] / DT, torch.tensor(gain).double(), atol=1e-6, rtol=0)


@pytest.mark.parametrize("codes", [None, 3])
def test_networks_read_ground_and_history(codes):
    model = unsettled((Recurrent(COMMANDED) if codes is None else coded(VEHICLE, codes)).double())
    at, other = (Situation(batch=1, codes=codes or 0, seed=seed) for seed in (1, 2))
    mine, others = at.source.terrain, other.source.terrain
    ground = others if codes is None else replace(mine, latent=others.latent)
    assert not torch.allclose(predict(model, at), predict(model, at, terrain=ground))
    assert not torch.allclose(predict(model, at), predict(model, at, history=other.history))


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_slopes_slow_the_bicycle_and_banks_push_it_downhill(yaw):
    model, start = Parametric(COMMANDED).double(), moving(yaw, vx=5.0)
    up, level, down = (run(model, start, constant(50, 0, 0, 0), climbing(50, s, yaw))[0, -1, 3] for s in (0.2, 0, -0.2))
    assert up < level < down
    # Gravity alone makes the difference: g sin(atan 0.2) for 1 s, each way.
    assert (level - up).item() == pytest.approx(GRAVITY * math.sin(math.atan(0.2)), rel=0.05)
    falls_to_the_right = climbing(25, 0.2, yaw + math.pi / 2)
    for heading, sign in ((yaw, -1), (yaw + math.pi, 1)):
        states = run(model, moving(heading, vx=5.0), constant(25, 0, 0, 0), falls_to_the_right)
        assert sign * states[0, -1, 4] > 0.01


def test_strong_brakes_hold_the_vehicle_on_a_slope_except_for_a_creep():
    """The regularised brake holds by creeping: v = 0.25 m/s atanh(gravity over braking)."""
    model = Parametric(COMMANDED).double()
    model.bicycle.raw.data[list(RANGES).index("brake_1")] = 2.0
    states = run(model, moving(), constant(250, 0, 1, 0), climbing(250, 0.1, 0.0))
    assert -0.05 < states[0, -1, 3] < 0
    assert abs(states[0, -1, 3] - states[0, -50, 3]) < 1e-6


@pytest.mark.parametrize("vx", [6.0, -6.0, 0.0])
def test_braking_stops_the_vehicle_without_reversing_it(vx):
    speeds = run(Parametric(COMMANDED).double(), moving(vx=vx), constant(250, 0, 1, 0.0 if vx else 1.0))[0, :, 3]
    assert (speeds.abs().diff() <= 0).all()
    assert speeds[-1].abs() < 1e-3
    assert speeds[-1] * vx >= -1e-9


def test_left_and_right_are_symmetric():
    model, at = unsettled(Parametric(COMMANDED).double()), Situation(steps=30).filled(COMMANDED, math.nan)
    flip = torch.tensor([1, -1, -1, 1, -1, -1]).double()
    normal = at.source.terrain.normal
    mirrored = replace(at.source.terrain, normal=normal * torch.tensor([1, -1, 1]).double())
    one = run(model, at.state, at.controls, at.source.terrain)
    other = run(model, at.state * flip, at.controls * torch.tensor([1, 1, -1]).double(), mirrored)
    torch.testing.assert_close(other, one * flip)


# --- The identifiable combinations of a known bicycle, recovered from its own drive ---

TRUTH = {
    "drive_1": 2.5, "drive_bend": 1.8, "engine_1": -0.3, "engine_2": 0.05, "brake_1": 1.2, "brake_2": 1.6,
    "resistance": 0.35, "resistance_slope": 1.5, "rear_peak": 5.0, "rear_shape": 1.2, "rear_stiffness": 3.5,
    "front_peak": 4.0, "front_shape": 1.4, "front_stiffness": 2.5, "rear_length": 0.55, "front_length": 0.4,
    "min_slip_speed": 1.5, "yaw_understeer": 0.75, "yaw_damping": 7.0, "drag_x": 0.012, "drag_y": 0.004,
    "gravity_x": 9.0, "gravity_y": 8.5,
}  # fmt: skip


def known_bicycle() -> Parametric:
    model = Parametric(COMMANDED).double()
    shares = torch.tensor([(TRUTH[name] - low) / (high - low) for name, (low, high, _) in RANGES.items()])
    model.bicycle.raw.data = torch.logit(shares.double())
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

    def drive(throttle: float, speed: float = 5.0) -> float:
        x = speed / 10
        return 2 * (1 + c.engine_1 * x + c.engine_2 * x * x) * (c.drive_1 * throttle + c.drive_2 * throttle**2) / c.mass

    def coasting(speed: float) -> float:
        return 2 * c.resistance * math.tanh(c.resistance_slope * speed) / c.mass + c.drag_x * speed * speed

    return {
        "steady yaw gain": c.yaw_gain / c.yaw_damping,
        "yaw damping": c.yaw_damping,
        **{f"drive at {throttle}": drive(throttle) for throttle in (0.3, 0.6, 1.0)},
        **{f"braking at {brake}": 2 * (c.brake_1 * brake + c.brake_2 * brake**2) / c.mass for brake in (0.5, 1.0)},
        **{f"coasting at {speed} m/s": coasting(speed) for speed in (3.0, 8.0)},
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

    begins = torch.cat((start[:, None], states[:, window - 1 : -1 : window]), dim=1).flatten(0, 1).float()
    targets, commands = cut(states)[..., 3:].float(), cut(controls).float()
    grounds = Terrain(cut(terrain.normal).float(), cut(terrain.known), cut(terrain.latent).float())
    scale = (targets - begins[:, None, 3:]).square().mean(dim=(0, 1))

    model = Parametric(COMMANDED)
    optimiser = torch.optim.Adam([model.bicycle.raw], lr=0.08)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 0.15, total_steps=300)
    for _ in range(300):
        predicted = run(model, begins, commands, grounds)[..., 3:]
        optimiser.zero_grad()
        ((predicted - targets).square().mean(dim=(0, 1)) / scale).sum().backward()
        optimiser.step()
        schedule.step()

    wanted, found = (identifiable(Constants(*(float(x.detach()) for x in m.bicycle()))) for m in (truth, model))
    off = {name: found[name] / wanted[name] - 1 for name in wanted}
    assert {name: error for name, error in off.items() if abs(error) > 0.03} == {}
