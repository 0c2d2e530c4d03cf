"""MPPI against exact results: linear-quadratic optima, Gaussian posteriors, and pytorch_mppi with equal noise."""

import math
from dataclasses import replace
from functools import partial

import pytest
import torch

from offpiste.core.errors import PlanningError
from offpiste.planning.controls import Limits
from offpiste.planning.mppi import Settings, improve, sample, shift, weigh
from offpiste.planning.noise import coloured, spectrum

FREE = Limits(low=(-math.inf,), high=(math.inf,))
DT = 0.1
A = torch.tensor([[1.0, DT], [0.0, 1.0]]).double()
B = torch.tensor([[0.0], [DT]]).double()
Q, R = torch.diag(torch.tensor([1.0, 0.1])).double(), 0.05
START = torch.tensor([1.0, 0.5]).double()
WHITE = partial(coloured, exponent=0.0)
PLAIN = Settings(FREE, (0.5,), noise=WHITE, wide=0.0, fresh=0.0, dt=DT)


def double_integrator(state, control):
    return state @ A.to(state.device).T + control @ B.to(state.device).T


def quadratic(state, control):
    return ((state @ Q.to(state.device)) * state).sum(-1) + R * control.square().sum(-1)


def pendulum(state, control):
    angle, rate = state.unbind(-1)
    rate = (rate + DT * (15 * torch.sin(angle) + 3 * control[:, 0])).clamp(-8, 8)
    return torch.stack((angle + DT * rate, rate), dim=-1)


def upright(state, control):
    angle = torch.remainder(state[:, 0] + math.pi, 2 * math.pi) - math.pi
    return angle.square() + 0.1 * state[:, 1].square() + 1e-3 * control[:, 0].square()


def costs(dynamics=double_integrator, running=quadratic, start=START):
    """Costs of control sequences by a system and a running cost."""

    def cost_of(controls):
        states, total = start.expand(len(controls), -1), 0.0
        for control in controls.unbind(dim=1):
            states = dynamics(states, control)
            total = total + running(states, control)
        return total

    return cost_of


def riccati(steps: int) -> torch.Tensor:
    """Optimal controls from START by the Riccati recursion; the cost counts states 1 ... T."""
    value, gains = torch.zeros(2, 2).double(), []
    for _ in range(steps):
        ahead = value + Q
        gain = torch.linalg.solve(R * torch.eye(1).double() + B.T @ ahead @ B, B.T @ ahead @ A)
        value = A.T @ ahead @ (A - B @ gain)
        gains.insert(0, gain)
    state, controls = START, []
    for gain in gains:
        controls.append(-gain @ state)
        state = A @ state + B @ controls[-1]
    return torch.stack(controls)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def nothing(steps: int, controls: int = 1) -> torch.Tensor:
    return torch.zeros(steps, controls, dtype=torch.float64)


def test_it_converges_to_the_linear_quadratic_optimum():
    wanted = riccati(20)
    cost_of, controls, draw = costs(), nothing(20), generator()
    for deviation in (1.0, 0.3, 0.1):
        settings = replace(PLAIN, deviation=(deviation,), samples=1000, iterations=30, temperature=deviation**2 / 10)
        controls = improve(controls, cost_of, settings, draw).controls
    best = cost_of(wanted[None]).item()
    assert best <= cost_of(controls[None]).item() == pytest.approx(best, rel=1e-3)
    torch.testing.assert_close(controls, wanted, atol=0.1, rtol=0)


def posterior(steps, temperature, parts):
    """Mean of exp(-S / temperature) under a mixture of Gaussians, S the cost of the double integrator.

    Args:
        parts: share, mean and covariance of each.
    """
    zero = nothing(steps)
    gradient = torch.func.grad(lambda u: costs()(u[None])[0])(zero)[:, 0] / temperature
    hessian = torch.func.hessian(lambda u: costs()(u[None])[0])(zero)[:, 0, :, 0] / temperature
    logs, means = [], []
    for share, mean, sigma in parts:
        precision, pull = hessian + torch.linalg.inv(sigma), torch.linalg.solve(sigma, mean)
        means.append(torch.linalg.solve(precision, pull - gradient))
        log = (means[-1] @ (pull - gradient) - mean @ pull - torch.logdet(precision @ sigma)) / 2
        logs.append(math.log(share) + log)
    return torch.softmax(torch.stack(logs), 0) @ torch.stack(means)


@pytest.mark.parametrize("exponent", [0.0, 2.0])
@pytest.mark.parametrize(("wide", "fresh"), [(0.0, 0.0), (0.3, 0.2)])
def test_one_update_is_the_mean_of_the_posterior_of_the_noise_mixture(exponent, wide, fresh):
    temperature, deviation, steps, around, rest = 0.5, 0.5, 4, 0.4, 1.5
    lag = torch.arange(steps)
    covariance = torch.fft.irfft(spectrum(2 * steps, exponent), n=2 * steps) / (2 * steps)
    sigma = deviation**2 * covariance[(lag[:, None] - lag).abs()]
    settings = replace(
        PLAIN, deviation=(deviation,), samples=200_000, temperature=temperature,
        noise=partial(coloured, exponent=exponent), wide=wide, width=3.0, fresh=fresh, fresh_width=2.0, rest=(rest,),
    )  # fmt: skip
    about = nothing(steps)[:, 0] + around
    parts = [(1 - wide - fresh, about, sigma), (wide, about, 9 * sigma), (fresh, about - around + rest, 4 * sigma)]
    wanted = posterior(steps, temperature, [part for part in parts if part[0] > 0])
    found = improve(about[:, None], costs(), settings, generator()).controls[:, 0]
    torch.testing.assert_close(found, wanted, atol=0.03, rtol=0)
    assert not wide or (wanted - posterior(steps, temperature, parts[:1])).abs().max() > 0.05, "all parts matter"


@pytest.mark.parametrize("bound", [math.inf, 0.6])
def test_given_its_noise_it_equals_pytorch_mppi(bound, monkeypatch):
    mppi = pytest.importorskip("pytorch_mppi").MPPI
    noise, temperature = 0.8 * WHITE((300, 15, 1), generator(), torch.float64), 0.9
    noise[0] = 0
    start = torch.tensor([math.pi, 0.2]).double()
    other = mppi(
        pendulum, upright, 2, torch.eye(1).double() * 0.64, num_samples=300, horizon=15, lambda_=temperature,
        u_min=nothing(1)[0] - bound, u_max=nothing(1)[0] + bound, U_init=nothing(15),
    )  # fmt: skip
    monkeypatch.setattr(other, "_sample_noise", lambda shape: noise)
    other.command(start, shift_nominal_trajectory=False)
    limits = Limits((-bound,), (bound,))
    settings = replace(PLAIN, limits=limits, deviation=(0.8,), samples=300, temperature=temperature)
    found = improve(nothing(15), costs(pendulum, upright, start), settings, generator())
    torch.testing.assert_close(found.controls, other.U, rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(found.weights, other.omega, rtol=1e-9, atol=1e-12)


def test_a_hanging_pendulum_is_swung_up_in_closed_loop():
    settings = replace(
        PLAIN, limits=Limits((-2.0,), (2.0,)), deviation=(1.5,), samples=400, temperature=0.1, noise=coloured
    )
    state, controls, draw, angles = torch.tensor([math.pi, 0.0]).double(), nothing(30), generator(), []
    for _ in range(80):
        controls = improve(controls, costs(pendulum, upright, state), settings, draw).controls
        state = pendulum(state[None], controls[:1])[0]
        controls = shift(controls)
        angles.append(abs(math.remainder(state[0].item(), 2 * math.pi)))
    assert min(angles[40:]) < 0.1
    assert max(angles[40:]) < 0.8


def test_the_same_seed_gives_the_same_plan_and_a_constant_cost_changes_nothing():
    settings = replace(PLAIN, noise=coloured, wide=0.1, fresh=0.1, samples=50, iterations=2)
    plans = [improve(nothing(10), costs(), settings, generator(seed)).controls for seed in (0, 0, 1)]
    assert torch.equal(plans[0], plans[1])
    assert not torch.equal(plans[0], plans[2])
    for constant in (7.0, 1e9, -1e9):
        raised = improve(nothing(10), lambda controls, c=constant: costs()(controls) + c, settings, generator())
        torch.testing.assert_close(raised.controls, plans[0], atol=1e-5, rtol=0)


def test_weights_of_hand_worked_costs():
    given = torch.tensor([1e9, 1e9 + math.log(4), math.inf, math.nan, -math.inf], dtype=torch.float64)
    torch.testing.assert_close(weigh(given, 1.0), torch.tensor([0.8, 0.2, 0, 0, 0]).double(), atol=1e-6, rtol=0)
    torch.testing.assert_close(weigh(torch.tensor([0.0, math.log(4)]), 0.5), torch.tensor([16 / 17, 1 / 17]))
    assert torch.equal(weigh(torch.tensor([0.0, 1e30]), 1e-3), torch.tensor([1.0, 0.0]))
    assert torch.equal(weigh(torch.full((4,), 3.0), 1e-9), torch.full((4,), 0.25))


def test_samples_without_finite_cost_are_left_out_and_a_plan_of_none_is_refused():
    def poisoned(controls):
        return torch.where(controls[:, 0, 0] > 0, torch.nan, costs()(controls))

    assert improve(nothing(8), poisoned, PLAIN, generator()).controls[0, 0] < 0
    with pytest.raises(PlanningError, match="none of 1024 sampled"):
        improve(nothing(5), lambda controls: torch.full((len(controls),), math.inf), PLAIN, generator())


def test_bounds_and_rates_hold():
    limits = Limits((-1.0, 0.0), (1.0, 0.5), (2.0, 1.0))
    settings = Settings(limits, (1.0, 1.0), samples=64, dt=0.1, temperature=0.01, noise=WHITE)
    previous, seen = torch.tensor([0.9, 0.0]).double(), []

    def cost_of(controls):
        seen.append(controls)
        return ((controls[..., 0] + 0.8).square() + (controls[..., 1] - 0.4).square()).sum(-1)

    found = improve(nothing(20, 2), cost_of, settings, generator(), previous=previous).controls
    for sequences in (*seen, found[None]):
        assert (sequences[..., 0].abs() <= 1).all()
        assert ((sequences[..., 1] >= 0) & (sequences[..., 1] <= 0.5)).all()
        steps = torch.cat((previous.expand(len(sequences), 1, 2), sequences), dim=1).diff(dim=1).abs()
        assert (steps <= torch.tensor([0.2, 0.1]) + 1e-9).all()


def test_shares_of_samples():
    settings = Settings(FREE, (1.0,), samples=1000, noise=WHITE, wide=0.3, width=10.0, fresh=0.2, rest=(5.0,))
    plan = nothing(50) - 2
    samples = sample(plan, replace(settings, fresh_width=4.0), generator())[..., 0]
    assert torch.equal(samples[0], plan[:, 0])
    assert torch.equal(samples[1], torch.full((50,), 5.0).double())
    for part, mean, deviation in ((samples[2:201], 5, 4), (samples[201:501], -2, 10), (samples[501:], -2, 1)):
        assert part.mean().item() == pytest.approx(mean, abs=0.3)
        assert part.std().item() == pytest.approx(deviation, rel=0.05)


def test_the_first_sample_keeps_a_perfect_plan():
    plan = riccati(20)
    found = improve(plan, costs(), replace(PLAIN, temperature=1e-9, deviation=(5.0,)), generator())
    torch.testing.assert_close(found.controls, plan)
    assert found.cost == pytest.approx(costs()(plan[None]).item())


def test_a_plan_is_shifted_by_the_steps_driven():
    plan = torch.arange(5.0)[:, None]
    assert shift(plan)[:, 0].tolist() == [1, 2, 3, 4, 4]
    assert shift(plan, 9)[:, 0].tolist() == [4] * 5
    assert torch.equal(shift(plan, 0), plan)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_a_gpu_reaches_the_optimum_too():
    settings = replace(PLAIN, samples=2000, iterations=30, temperature=0.05)
    cost_of, draw = costs(start=START.cuda()), torch.Generator("cuda").manual_seed(0)
    found = improve(nothing(20).cuda(), cost_of, settings, draw).controls
    assert cost_of(found[None]).item() == pytest.approx(cost_of(riccati(20).cuda()[None]).item(), rel=0.02)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"samples": 0}, r"samples \(0\) and iterations \(1\)"),
        ({"temperature": float("nan")}, r"temperature \(nan\)"),
        ({"dt": -0.02}, r"dt \(-0.02 s\)"),
        ({"fresh": 0.6, "wide": 0.5}, "0 to 1 in total"),
    ],
)
def test_impossible_settings_are_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        Settings(Limits((0.0,), (1.0,)), (0.1,), **wrong)
