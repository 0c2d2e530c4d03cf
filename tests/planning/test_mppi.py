"""MPPI against what is known exactly: linear-quadratic optima, Gaussian posteriors, another library given its noise."""

import math
from dataclasses import replace
from functools import partial

import pytest
import torch

from offpiste.core.errors import PlanningError
from offpiste.planning.mppi import Limits, Settings, improve, sample, shift, smoothed, weigh
from offpiste.planning.noise import coloured, covariance, gaussian, lifted
from offpiste.planning.rollouts import callable_costs

FREE = Limits(low=(-math.inf,), high=(math.inf,))
DT = 0.1
A = torch.tensor([[1.0, DT], [0.0, 1.0]]).double()
B = torch.tensor([[0.0], [DT]]).double()
Q, R = torch.diag(torch.tensor([1.0, 0.1])).double(), 0.05
START = torch.tensor([1.0, 0.5]).double()
PLAIN = Settings(FREE, (0.5,), noise=gaussian, wide=0.0, fresh=0.0, dt=DT)


def double_integrator(state, control):
    return state @ A.T + control @ B.T


def quadratic(state, control):
    return ((state @ Q) * state).sum(-1) + R * control.square().sum(-1)


def pendulum(state, control):
    angle, rate = state.unbind(-1)
    rate = (rate + DT * (15 * torch.sin(angle) + 3 * control[:, 0])).clamp(-8, 8)
    return torch.stack((angle + DT * rate, rate), dim=-1)


def upright(state, control):
    angle = torch.remainder(state[:, 0] + math.pi, 2 * math.pi) - math.pi
    return angle.square() + 0.1 * state[:, 1].square() + 1e-3 * control[:, 0].square()


SYSTEMS = {
    "double integrator": (double_integrator, quadratic, START),
    "pendulum": (pendulum, upright, torch.tensor([math.pi, 0.2]).double()),
}


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


def cost(name, controls):
    dynamics, running, start = SYSTEMS[name]
    return callable_costs(dynamics, running, start)(controls[None]).item()


def test_it_converges_to_the_linear_quadratic_optimum():
    wanted = riccati(20)
    cost_of = callable_costs(double_integrator, quadratic, START)
    controls, draw = nothing(20), generator()
    for deviation in (1.0, 0.3, 0.1):
        settings = replace(PLAIN, deviation=(deviation,), samples=1000, iterations=30, temperature=deviation**2 / 10)
        controls = improve(controls, cost_of, settings, draw).controls
    best = cost_of(wanted[None]).item()
    assert cost_of(controls[None]).item() == pytest.approx(best, rel=1e-3)
    assert cost_of(controls[None]).item() >= best
    torch.testing.assert_close(controls, wanted, atol=0.1, rtol=0)


def posterior(steps, temperature, parts):
    """Mean of exp(-S / temperature) under a mixture of Gaussians, S the cost of the double integrator.

    Args:
        parts: share, mean and covariance of each.
    """
    cost_of = callable_costs(double_integrator, quadratic, START)
    zero = nothing(steps)
    gradient = torch.func.grad(lambda u: cost_of(u[None])[0])(zero)[:, 0] / temperature
    hessian = torch.func.hessian(lambda u: cost_of(u[None])[0])(zero)[:, 0, :, 0] / temperature
    logs, means = [], []
    for share, mean, sigma in parts:
        precision, pull = hessian + torch.linalg.inv(sigma), torch.linalg.solve(sigma, mean)
        means.append(torch.linalg.solve(precision, pull - gradient))
        log = (means[-1] @ (pull - gradient) - mean @ pull - torch.logdet(precision @ sigma)) / 2
        logs.append(math.log(share) + log)
    return torch.softmax(torch.stack(logs), 0) @ torch.stack(means)


@pytest.mark.parametrize("noise", [gaussian, coloured, partial(coloured, exponent=1.0, period=12), lifted])
@pytest.mark.parametrize("ratio", [0.0, 0.5, 1.0])
def test_one_step_is_the_mean_of_the_gaussian_posterior(noise, ratio):
    # Weights x density are exp(-S / lambda) N(v; (1 - ratio) u, Sigma): with 1, whatever plan was sampled around.
    temperature, deviation, steps = 0.5, 0.7, 6
    sigma = deviation**2 * covariance(noise, steps)
    settings = replace(
        PLAIN, deviation=(deviation,), samples=100_000, temperature=temperature, control_cost=ratio * temperature,
        noise=noise,
    )  # fmt: skip
    wanted = []
    for around in (0.0, 0.25):
        plan = nothing(steps) + around
        wanted.append(posterior(steps, temperature, [(1.0, (1 - ratio) * plan[:, 0], sigma)]))
        found = improve(plan, callable_costs(double_integrator, quadratic, START), settings, generator())
        assert found.effective_samples > 5_000
        tolerance = 4.5 * deviation / math.sqrt(found.effective_samples)
        torch.testing.assert_close(found.controls[:, 0], wanted[-1], atol=tolerance, rtol=0)
    assert (ratio == 1) == torch.equal(*wanted)


@pytest.mark.parametrize("noise", [gaussian, coloured])
@pytest.mark.parametrize("ratio", [0.0, 1.0])
def test_wide_and_fresh_samples_are_parts_of_the_prior(noise, ratio):
    temperature, deviation, steps, rest = 0.5, 0.5, 4, 1.5
    sigma = deviation**2 * covariance(noise, steps)
    settings = replace(
        PLAIN, deviation=(deviation,), samples=200_000, temperature=temperature, control_cost=ratio * temperature,
        noise=noise, wide=0.3, width=3.0, fresh=0.2, fresh_width=2.0, rest=(rest,),
    )  # fmt: skip
    zero, wanted = nothing(steps)[:, 0], []
    for around in (0.0, 0.4):
        about = zero + (1 - ratio) * around
        parts = [(0.5, about, sigma), (0.3, about, 9 * sigma), (0.2, zero + rest, 4 * sigma)]
        wanted.append(posterior(steps, temperature, parts))
        cost_of = callable_costs(double_integrator, quadratic, START)
        found = improve(nothing(steps) + around, cost_of, settings, generator()).controls[:, 0]
        torch.testing.assert_close(found, wanted[-1], atol=0.03, rtol=0)
        assert (wanted[-1] - posterior(steps, temperature, parts[:1])).abs().max() > 0.05, "the other parts matter"
    assert (ratio == 1) == torch.equal(*wanted)


@pytest.mark.parametrize("noise", [gaussian, coloured])
def test_with_limits_too_the_mean_does_not_depend_on_the_plan_sampled_around(noise):
    # Limits are part of the system that is planned for: the ratio of densities is that of the draws before them.
    limits = Limits((-0.3,), (0.5,), (4.0,))
    settings = replace(
        PLAIN, limits=limits, deviation=(0.7,), samples=200_000, temperature=0.5, control_cost=0.5, noise=noise
    )
    cost_of = callable_costs(double_integrator, quadratic, START)
    found = [improve(nothing(8) + around, cost_of, settings, generator()).controls for around in (0.0, 0.4)]
    torch.testing.assert_close(found[0], found[1], atol=0.01, rtol=0)


def heavy_tailed(shape, generator, dtype=torch.float32):
    """A noise of a user's own."""
    return gaussian(shape, generator, dtype) ** 3


@pytest.mark.parametrize(
    ("noise", "match"),
    [
        (heavy_tailed, "noise 'heavy_tailed', only of gaussian, coloured, lifted"),
        (partial(lifted, noise=heavy_tailed), "noise 'heavy_tailed'"),
        (lambda *_: torch.zeros(1), "noise '<lambda>'"),
        (partial(coloured, highest=5), "leave out `highest`"),
    ],
)
def test_a_control_cost_without_the_covariance_of_the_noise_is_refused(noise, match):
    replace(PLAIN, noise=noise)
    with pytest.raises(ValueError, match=f"control_cost needs the covariance of the noise: .*{match}"):
        replace(PLAIN, noise=noise, control_cost=0.1)


@pytest.mark.parametrize(("bound", "planned"), [(math.inf, 0.3), (0.6, 0.0)])
@pytest.mark.parametrize("name", SYSTEMS)
def test_given_its_noise_it_does_what_pytorch_mppi_does(name, bound, planned):
    # Its control cost is that of the noise that bounds leave, ours that of the noise drawn: alike without either.
    mppi = pytest.importorskip("pytorch_mppi").MPPI
    dynamics, running, start = SYSTEMS[name]
    noise = 0.8 * gaussian((300, 15, 1), generator(), torch.float64)
    noise[0] = 0
    plan = planned * gaussian((1, 15, 1), generator(1), torch.float64)[0]
    temperature = 0.9
    other = mppi(
        dynamics, running, 2, torch.eye(1).double() * 0.64, num_samples=300, horizon=15, lambda_=temperature,
        u_min=nothing(1)[0] - bound, u_max=nothing(1)[0] + bound, U_init=plan.clamp(-bound, bound),
    )  # fmt: skip
    other._sample_noise = lambda shape: noise
    other.command(start, shift_nominal_trajectory=False)
    settings = replace(
        PLAIN, limits=Limits((-bound,), (bound,)), deviation=(0.8,), samples=300, temperature=temperature,
        control_cost=temperature,
    )  # fmt: skip
    found = improve(plan.clamp(-bound, bound), callable_costs(dynamics, running, start), settings, generator())
    torch.testing.assert_close(found.controls, other.U, rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(found.weights, other.omega, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", SYSTEMS)
def test_it_reaches_the_cost_of_pytorch_mppi_at_equal_samples(name):
    mppi = pytest.importorskip("pytorch_mppi").MPPI
    dynamics, running, start = SYSTEMS[name]
    ours, theirs = [], []
    for seed in range(4):
        torch.manual_seed(seed)
        other = mppi(
            dynamics, running, 2, torch.eye(1).double(), num_samples=200, horizon=20, lambda_=0.1,
            u_min=torch.tensor([-3.0]).double(), u_max=torch.tensor([3.0]).double(), U_init=nothing(20),
        )  # fmt: skip
        for _ in range(25):
            other.command(start, shift_nominal_trajectory=False)
        theirs.append(cost(name, other.U))
        settings = replace(
            PLAIN, limits=Limits((-3.0,), (3.0,)), deviation=(1.0,), samples=200, temperature=0.1, iterations=25,
            control_cost=0.1,
        )  # fmt: skip
        found = improve(nothing(20), callable_costs(dynamics, running, start), settings, generator(seed))
        ours.append(cost(name, found.controls))
    assert sum(ours) == pytest.approx(sum(theirs), rel=0.05)


def test_a_pendulum_that_hangs_is_swung_up_in_closed_loop():
    settings = replace(
        PLAIN, limits=Limits((-2.0,), (2.0,)), deviation=(1.5,), samples=400, temperature=0.1, noise=coloured
    )
    state, controls, draw, angles = torch.tensor([math.pi, 0.0]).double(), nothing(30), generator(), []
    for _ in range(80):
        controls = improve(controls, callable_costs(pendulum, upright, state), settings, draw).controls
        state = pendulum(state[None], controls[:1])[0]
        controls = shift(controls)
        angles.append(abs(math.remainder(state[0].item(), 2 * math.pi)))
    # Weak and noisy as it is, it sways about the top, and not always by less than 0.1.
    assert min(angles[40:]) < 0.1
    assert max(angles[40:]) < 0.8


def test_the_same_seed_gives_the_same_plan():
    settings = replace(PLAIN, noise=coloured, wide=0.1, fresh=0.1, samples=50, iterations=2)
    cost_of = callable_costs(double_integrator, quadratic, START)
    plans = [improve(nothing(10), cost_of, settings, generator(seed)).controls for seed in (0, 0, 1)]
    assert torch.equal(plans[0], plans[1])
    assert not torch.equal(plans[0], plans[2])


@pytest.mark.parametrize("constant", [7.0, 1e9, -1e9])
def test_a_constant_added_to_all_costs_changes_nothing(constant):
    cost_of = callable_costs(double_integrator, quadratic, START)
    plain = improve(nothing(10), cost_of, PLAIN, generator()).controls
    raised = improve(nothing(10), lambda controls: cost_of(controls) + constant, PLAIN, generator()).controls
    torch.testing.assert_close(raised, plain, atol=1e-5, rtol=0)


def test_weights_of_hand_worked_costs():
    costs = torch.tensor([1e9, 1e9 + math.log(4), math.inf, math.nan, -math.inf], dtype=torch.float64)
    weights = weigh(costs, 1.0)
    torch.testing.assert_close(weights, torch.tensor([0.8, 0.2, 0, 0, 0]).double(), atol=1e-6, rtol=0)
    warm = weigh(torch.tensor([0.0, math.log(4)]), 0.5)
    torch.testing.assert_close(warm, torch.tensor([16 / 17, 1 / 17]))
    assert torch.equal(weigh(torch.tensor([0.0, 1e30]), 1e-3), torch.tensor([1.0, 0.0]))
    assert torch.equal(weigh(torch.full((4,), 3.0), 1e-9), torch.full((4,), 0.25))


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_costs_of_which_none_is_finite_are_refused(value):
    with pytest.raises(PlanningError, match="none of 1024 sampled"):
        improve(nothing(5), lambda controls: torch.full((len(controls),), value), PLAIN, generator())


def test_samples_that_are_not_finite_are_left_out():
    cost_of = callable_costs(double_integrator, quadratic, START)

    def poisoned(controls):
        return torch.where(controls[:, 0, 0] > 0, torch.nan, cost_of(controls))

    assert improve(nothing(8), poisoned, PLAIN, generator()).controls[0, 0] < 0


def test_bounds_and_rates_hold_after_smoothing_too():
    limits = Limits((-1.0, 0.0), (1.0, 0.5), (2.0, 1.0))
    settings = Settings(limits, (1.0, 1.0), samples=64, dt=0.1, temperature=0.01, smoothing=7, noise=gaussian)
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
    settings = Settings(FREE, (1.0,), samples=1000, noise=gaussian, wide=0.3, width=10.0, fresh=0.2, rest=(5.0,))
    settings = replace(settings, fresh_width=4.0)
    plan = nothing(50) - 2
    samples = sample(plan, settings, generator())[..., 0]
    assert torch.equal(samples[0], plan[:, 0])
    assert torch.equal(samples[1], torch.full((50,), 5.0).double())
    for part, mean, deviation in ((samples[2:201], 5, 4), (samples[201:501], -2, 10), (samples[501:], -2, 1)):
        assert part.mean().item() == pytest.approx(mean, abs=0.3)
        assert part.std().item() == pytest.approx(deviation, rel=0.05)


def test_the_first_sample_keeps_a_perfect_plan():
    plan = riccati(20)
    settings = replace(PLAIN, temperature=1e-9, deviation=(5.0,))
    found = improve(plan, callable_costs(double_integrator, quadratic, START), settings, generator())
    torch.testing.assert_close(found.controls, plan)
    assert found.effective_samples == pytest.approx(1)


def test_smoothing_keeps_straight_lines_and_damps_noise():
    ramp = torch.arange(20.0)[:, None].double()
    torch.testing.assert_close(smoothed(ramp, 9)[4:-4], ramp[4:-4])
    assert torch.equal(smoothed(ramp, 0), ramp)
    noise = gaussian((1, 200, 1), generator(), torch.float64)[0]
    assert smoothed(noise, 9).std() < 0.8 * noise.std()


def test_a_plan_is_shifted_by_the_steps_driven():
    plan = torch.arange(5.0)[:, None]
    assert shift(plan)[:, 0].tolist() == [1, 2, 3, 4, 4]
    assert shift(plan, 3)[:, 0].tolist() == [3, 4, 4, 4, 4]
    assert shift(plan, 9)[:, 0].tolist() == [4] * 5
    assert torch.equal(shift(plan, 0), plan)


def test_a_terminal_cost_counts_the_last_state_once():
    cost_of = callable_costs(
        double_integrator, lambda state, control: 0 * state[:, 0], START, terminal_cost=lambda state: state[:, 0]
    )
    assert cost_of(nothing(2)[None]).item() == pytest.approx(1.0 + 2 * DT * 0.5)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_a_gpu_reaches_the_optimum_too():
    settings = replace(PLAIN, samples=2000, iterations=30, temperature=0.05)
    start = START.cuda()
    cost_of = callable_costs(
        lambda x, u: x @ A.T.cuda() + u @ B.T.cuda(),
        lambda x, u: ((x @ Q.cuda()) * x).sum(-1) + R * u.square().sum(-1),
        start,
    )
    draw = torch.Generator("cuda").manual_seed(0)
    found = improve(nothing(20).cuda(), cost_of, settings, draw).controls
    assert cost_of(found[None]).item() == pytest.approx(cost_of(riccati(20).cuda()[None]).item(), rel=0.02)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"samples": 0}, "0 samples and 1 iterations"),
        ({"iterations": 0}, "1024 samples and 0 iterations"),
        ({"temperature": 0.0}, "a temperature of 0"),
        ({"temperature": float("nan")}, "a temperature of nan"),
        ({"dt": -0.02}, "steps of -0.02 s"),
        ({"fresh": 0.6, "wide": 0.5}, "together at most 1"),
        ({"smoothing": -5}, "smoothing over -5 steps"),
    ],
)
def test_settings_that_no_plan_can_be_made_with_are_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        Settings(Limits((0.0,), (1.0,)), (0.1,), **wrong)


def test_smoothing_over_an_even_length_is_refused():
    with pytest.raises(ValueError, match="6 steps; it has to be odd"):
        Settings(Limits((0.0,), (1.0,)), (0.1,), smoothing=6)
