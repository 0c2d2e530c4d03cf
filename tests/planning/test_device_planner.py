"""The GPU planner, its kernels compiled for the CPU, against `mppi.improve` with the fused kernel."""

import gc
import weakref
from dataclasses import replace
from functools import partial

import pytest
import torch

from host_kernels import HostKernels, needs_gcc
from offpiste.core.errors import PlanningError
from offpiste.planning.controls import CONTROL_LIMITS, PEDAL_LIMITS, with_pedal
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.device_planner import DevicePlanner, power_of_two, prepared
from offpiste.planning.gpu import check_planner, gpu_planner
from offpiste.planning.header.cost_text import plan_text
from offpiste.planning.kernel import encode_map, fused_costs
from offpiste.planning.mppi import Settings, improve
from offpiste.planning.noise import coloured
from planning.test_kernel import STEPS, caution, ground, model, start
from planning_maps import layers, situation

SETTINGS = Settings(
    PEDAL_LIMITS, (0.15, 0.15), samples=128, temperature=3.0, iterations=2, wide=0.3, fresh=0.1, fresh_width=5.0,
    rest=(0.4, 0.0),
)  # fmt: skip


def parts(at, kind="dc"):
    dynamics = model(kind)
    return dynamics, start(dynamics, at), encode_map(at.ground, dynamics.encoder)


def drawn_on_device(settings):
    """Settings for the CPU with the noise that a device draws from the same seed."""
    return replace(settings, noise=prepared(settings.noise, STEPS, torch.device("cpu")))


@needs_gcc
@pytest.mark.parametrize(
    "settings",
    [
        SETTINGS,
        replace(SETTINGS, noise=partial(coloured, exponent=1.0, period=150, highest=20)),
        Settings(replace(CONTROL_LIMITS, rate=None), (0.3, 0.1, 0.3), samples=100),
    ],
    ids=["run time", "few frequencies", "two pedals without rates"],
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
        wanted = improve(plan, cost_of, drawn_on_device(settings), generator, previous=previous)
        found = planner.improve(plan, model_state, at, CostWeights(), codes, previous=previous)
        torch.testing.assert_close(found.controls, wanted.controls, atol=2e-3, rtol=0)
        torch.testing.assert_close(found.costs, wanted.costs, atol=1e-2, rtol=1e-3)
        assert abs(float(found.weights.sum()) - 1) < 1e-6
        plan = wanted.controls


@needs_gcc
def test_plans_that_count_their_spread_are_those_of_the_reference_and_checked_with_it():
    at = situation(layers(plane=(0.05, -0.1)), state=(-10.0, 1, 0.1, 4, 0, 0))
    dynamics, model_state, codes = parts(at)
    careful = replace(at, caution=caution(dynamics))
    kernels = HostKernels(plan_text(dynamics, at.costs.table, careful.caution))
    planner = DevicePlanner(kernels, dynamics, SETTINGS, torch.Generator().manual_seed(3))
    given = torch.zeros(STEPS, 2), model_state, careful, CostWeights(), codes
    cost_of = with_pedal(fused_costs(dynamics, *given[1:]))
    wanted = improve(given[0], cost_of, drawn_on_device(SETTINGS), torch.Generator().manual_seed(3))
    found = planner.improve(*given)
    torch.testing.assert_close(found.controls, wanted.controls, atol=2e-3, rtol=0)
    torch.testing.assert_close(found.costs, wanted.costs, atol=1e-2, rtol=1e-3)
    check_planner(planner, *given)
    as_predicted = DevicePlanner(
        HostKernels(plan_text(dynamics, at.costs.table)), dynamics, SETTINGS, torch.Generator()
    )
    with pytest.raises(PlanningError, match="costs on cpu differ from those on the CPU"):
        check_planner(as_predicted, *given)


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
    lanes = 1

    def launch(self, name, count, *arguments, lanes=1):
        raise AssertionError(name)


def test_maps_that_are_large_in_different_ways_do_not_take_turns_with_new_buffers():
    dynamics, _, _ = parts(situation(), "b")
    planner = DevicePlanner(Nothing(), dynamics, SETTINGS, torch.Generator())
    wide, deep, wider = (tuple(torch.zeros(n) for n in sizes) for sizes in ((10, 3, 2), (2, 3, 10), (12, 3, 12)))
    given = torch.zeros(20, 2), torch.zeros(30)
    first, second = planner._buffers_for(*given, wide), planner._buffers_for(*given, deep)
    assert second is not first
    assert planner._buffers_for(*given, wide) is second
    assert (second.slope.numel(), second.layers.numel()) == (16, 16)
    assert planner._buffers_for(*given, wider) is second  # a map that grows by a little means no other graph
    assert [power_of_two(count) for count in (0, 1, 2, 3, 1024, 1025)] == [1, 1, 2, 4, 1024, 2048]


def with_graph(capture):
    """A planner whose work `capture` repeats, and what its plans need."""
    at = situation(layers(41), state=(-5.0, 1, 0.1, 4, 0, 0))
    dynamics, model_state, codes = parts(at)
    kernels = HostKernels(plan_text(dynamics, at.costs.table))
    planner = DevicePlanner(kernels, dynamics, SETTINGS, torch.Generator().manual_seed(1), capture)
    plain = DevicePlanner(kernels, dynamics, SETTINGS, torch.Generator().manual_seed(1))
    return planner, plain, (torch.zeros(20, 2), model_state, at, CostWeights(), codes)


@needs_gcc
def test_what_a_graph_reads_lives_as_long_as_the_graph():
    noises = []

    def capture(work, generator):
        noises.append(weakref.ref(work.args[1]))
        return lambda: None

    planner, _, given = with_graph(capture)
    planner.load(*given)
    gc.collect()
    assert noises[0]() is not None


@needs_gcc
def test_a_graph_is_checked_before_its_first_plan_and_changes_no_random_number():
    runs = []

    def capture(work, generator):
        def replay():
            runs.append("replay")
            work()

        return replay

    planner, plain, given = with_graph(capture)
    for turn in range(2):
        assert torch.equal(planner.improve(*given).controls, plain.improve(*given).controls)
        assert len(runs) == 3 + turn  # two to be checked, and one a plan


@needs_gcc
@pytest.mark.parametrize("wrong", ["plan", "costs", "weights", "NaN", "second time"])
def test_a_graph_that_plans_otherwise_is_refused_each_time(wrong):
    runs = []

    def capture(work, generator):
        b = work.args[0]

        def replay():
            runs.append(wrong)
            work()
            if wrong == "NaN":
                b.costs[0] = torch.nan
            elif wrong == "costs":
                b.costs.mul_(1.01)
            elif wrong != "second time" or len(runs) % 2 == 0:
                (b.weights if wrong == "weights" else b.plan)[0] += 0.01

        return replay

    planner, _, given = with_graph(capture)
    for _ in range(2):
        with pytest.raises(PlanningError, match="a CUDA graph on cpu plans differently from its kernels"):
            planner.improve(*given)


@needs_gcc
def test_where_there_is_no_graph_no_plan_is_made_without():
    def capture(work, generator):
        raise PlanningError("no CUDA graph of a plan")

    planner, _, given = with_graph(capture)
    for _ in range(2):
        with pytest.raises(PlanningError, match="no CUDA graph"):
            planner.improve(*given)


@needs_gcc
def test_cells_are_copied_again_only_where_a_map_is_another_or_has_changed(monkeypatch):
    planner, _, given = with_graph(None)
    copied = []
    monkeypatch.setattr("offpiste.planning.device_planner.into", lambda room, part: copied.append(room.copy_(part)))
    plan, model_state, at, weights, codes = given

    def copies():
        copied.clear()
        planner.load(plan, model_state, at, weights, codes)
        return len(copied) - 3  # plan, bounds and situation are always copied

    assert [copies(), copies()] == [3, 0]
    at.ground.slope.add_(0.1)
    assert copies() == 1
    assert torch.equal(planner._buffers.slope[: at.ground.slope.numel()], at.ground.slope.flatten())
    codes = codes[0].clone(), codes[1]
    assert copies() == 1
    planner.load(torch.zeros(30, 2), model_state, at, weights, codes)
    assert torch.equal(planner._buffers.slope[: at.ground.slope.numel()], at.ground.slope.flatten())
    with torch.inference_mode():
        codes = codes[0].clone(), codes[1]
    copies()
    assert copies() == 1


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_refused():
    with pytest.raises(PlanningError, match="no GPU 'cuda' for planning"):
        gpu_planner(model("b"), SETTINGS, situation(), "cuda", 0)
