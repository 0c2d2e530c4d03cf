"""The planner for GPUs, its kernels compiled for this machine, against `mppi.improve` with the fused kernel."""

from dataclasses import replace
from functools import partial

import pytest
import torch

from host_kernels import HostKernels, needs_gcc
from offpiste.errors import PlanningError
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.device_planner import DevicePlanner
from offpiste.planning.gpu import check_planner, gpu_planner
from offpiste.planning.header.cost_text import plan_text
from offpiste.planning.kernel import encode_map, fused_costs
from offpiste.planning.mppi import PEDALS_AND_WHEEL, Settings, improve
from offpiste.planning.noise import coloured, gaussian
from offpiste.planning.pedal import PEDAL_AND_WHEEL, with_pedal
from planning.test_kernel import STEPS, ground, model, start
from planning_maps import layers, situation

SETTINGS = Settings(
    PEDAL_AND_WHEEL, (0.15, 0.15), samples=128, temperature=3.0, iterations=2, wide=0.3, fresh=0.1, fresh_width=5.0,
    rest=(0.4, 0.0), smoothing=9,
)  # fmt: skip


def parts(at, kind="dc"):
    dynamics = model(kind)
    return dynamics, start(dynamics, at), encode_map(at.ground, dynamics.encoder)


@needs_gcc
@pytest.mark.parametrize(
    "settings",
    [
        SETTINGS,
        replace(SETTINGS, noise=gaussian, iterations=1),
        replace(SETTINGS, noise=partial(coloured, exponent=1.0, period=150, highest=20)),
        Settings(PEDALS_AND_WHEEL, (0.3, 0.1, 0.3), samples=100),
        Settings(replace(PEDALS_AND_WHEEL, rate=None), (0.3, 0.1, 0.3), samples=100),
    ],
    ids=["as the run time", "white", "few frequencies", "two pedals", "no rates"],
)
def test_plans_are_those_of_the_reference(settings):
    at = situation(layers(plane=(0.05, -0.1)), state=(-10.0, 1, 0.1, 4, 0, 0))
    dynamics, model_state, codes = parts(at)
    planner = DevicePlanner(
        HostKernels(plan_text(dynamics, at.costs.table)), dynamics, settings, torch.Generator().manual_seed(3)
    )
    count = len(settings.deviation)
    plan, previous, generator = torch.zeros(STEPS, count), torch.full((count,), 0.1), torch.Generator().manual_seed(3)
    for _ in range(2):  # the second one starts from the first
        costs = fused_costs(dynamics, model_state, at, CostWeights(), codes)
        cost_of = with_pedal(costs) if count == 2 else costs
        wanted = improve(plan, cost_of, settings, generator, previous=previous)
        found = planner.improve(plan, model_state, at, CostWeights(), codes, previous=previous)
        torch.testing.assert_close(found.controls, wanted.controls, atol=2e-3, rtol=0)
        torch.testing.assert_close(found.costs, wanted.costs, atol=1e-2, rtol=1e-3)
        assert abs(float(found.weights.sum()) - 1) < 1e-6
        plan = wanted.controls


@needs_gcc
def test_a_larger_map_and_another_length_of_plan_get_new_buffers():
    small = situation(layers(41), state=(-5.0, 1, 0.1, 4, 0, 0))
    dynamics, model_state, _ = parts(small)
    kernels = HostKernels(plan_text(dynamics, small.costs.table))
    planner = DevicePlanner(kernels, dynamics, SETTINGS, torch.Generator().manual_seed(0))
    for at, steps in ((small, 20), (situation(ground()), 20), (small, 30), (situation(ground()), 30)):
        codes = encode_map(at.ground, dynamics.encoder)
        alone = DevicePlanner(kernels, dynamics, SETTINGS, torch.Generator().manual_seed(1))
        planner._generator.manual_seed(1)
        plan = torch.zeros(steps, 2)
        given = (plan, model_state, at, CostWeights(), codes)
        assert torch.equal(planner.improve(*given).controls, alone.improve(*given).controls)


@needs_gcc
def test_where_no_sample_is_finite_it_says_so():
    at = situation(layers(), state=(float("nan"), 0, 0, 5, 0, 0))
    dynamics, model_state, codes = parts(at)
    planner = DevicePlanner(HostKernels(plan_text(dynamics, at.costs.table)), dynamics, SETTINGS, torch.Generator())
    with pytest.raises(PlanningError, match="none of 128 sampled trajectories has a finite cost"):
        planner.improve(torch.zeros(20, 2), model_state, at, CostWeights(), codes)


@needs_gcc
def test_kernels_that_compute_something_else_are_refused():
    at = situation(layers(plane=(0.05, -0.1)), state=(-10.0, 1, 0.1, 4, 0, 0))
    dynamics, model_state, codes = parts(at)
    given = torch.zeros(40, 2), model_state, at, CostWeights(), codes
    text = plan_text(dynamics, at.costs.table)
    check_planner(DevicePlanner(HostKernels(text), dynamics, SETTINGS, torch.Generator()), *given)
    wrong = text.replace("0.02f*yaw_rate", "0.04f*yaw_rate")
    assert wrong != text
    planner = DevicePlanner(HostKernels(wrong), dynamics, SETTINGS, torch.Generator())
    with pytest.raises(PlanningError, match="costs on cpu differ from those on the CPU"):
        check_planner(planner, *given)
    unlimited = text.replace("controls[t * items + i] = before = value;", "controls[t * items + i] = before = 9.0f;")
    assert unlimited != text
    planner = DevicePlanner(HostKernels(unlimited), dynamics, SETTINGS, torch.Generator())
    with pytest.raises(PlanningError, match="limits of controls on cpu differ"):
        check_planner(planner, *given)


class Nothing:
    def launch(self, name, count, *arguments):
        raise AssertionError(name)


def test_maps_that_are_large_in_different_ways_do_not_take_turns_with_new_buffers():
    dynamics, _, _ = parts(situation(), "b")
    planner = DevicePlanner(Nothing(), dynamics, SETTINGS, torch.Generator())
    wide, deep = (tuple(torch.zeros(n) for n in sizes) for sizes in ((10, 3, 2), (2, 3, 10)))
    given = torch.zeros(20, 2), torch.zeros(30)
    first, second = planner._buffers_for(*given, wide), planner._buffers_for(*given, deep)
    assert second is not first
    assert planner._buffers_for(*given, wide) is second
    assert (second.slope.numel(), second.layers.numel()) == (10, 10)


def test_what_a_gpu_cannot_do_is_refused():
    at = situation()
    dynamics, _, _ = parts(at, "b")
    with pytest.raises(PlanningError, match="a control cost is not computed on a GPU"):
        DevicePlanner(Nothing(), dynamics, replace(SETTINGS, noise=gaussian, control_cost=1.0), torch.Generator())
    if not torch.cuda.is_available():
        with pytest.raises(PlanningError, match="no GPU 'cuda' for planning"):
            gpu_planner(dynamics, SETTINGS, at, "cuda", 0)
