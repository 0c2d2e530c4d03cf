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


DYNAMICS = model("dc")
SLOPE = situation(layers(plane=(0.05, -0.1)), state=(-10.0, 1, 0.1, 4, 0, 0))


def given(at, plan):
    """Arguments of a plan."""
    return plan, start(DYNAMICS, at), at, CostWeights(), encode_map(at.ground, DYNAMICS.encoder)


def planner(at=SLOPE, settings=SETTINGS, *, seed=3, capture=None, wrong=("", "")):
    """A planner with kernels for the layers and the caution of a situation; `wrong` exchanges a part of their text."""
    text = plan_text(DYNAMICS, at.costs.table, at.caution)
    assert wrong[0] in text
    kernels, generator = HostKernels(text.replace(*wrong)), torch.Generator().manual_seed(seed)
    return DevicePlanner(kernels, DYNAMICS, settings, generator, capture)


def reference(settings, plan, *rest, previous, generator):
    """The plan of `mppi.improve` with the noise that a device draws from the same seed."""
    costs = fused_costs(DYNAMICS, *rest)
    settings = replace(settings, noise=prepared(settings.noise, STEPS, torch.device("cpu")))
    cost_of = with_pedal(costs) if plan.shape[1] == 2 else costs
    return improve(plan, cost_of, settings, generator, previous=previous)


@needs_gcc
@pytest.mark.parametrize(
    ("settings", "careful"),
    [
        (SETTINGS, False),
        (SETTINGS, True),
        (replace(SETTINGS, noise=partial(coloured, exponent=1.0, period=150, highest=20)), False),
        (Settings(replace(CONTROL_LIMITS, rate=None), (0.3, 0.1, 0.3), samples=100), False),
    ],
    ids=["run time", "with a spread", "few frequencies", "two pedals without rates"],
)
def test_plans_are_those_of_the_reference(settings, careful):
    at = replace(SLOPE, caution=caution(DYNAMICS)) if careful else SLOPE
    device, count, generator = planner(at, settings), len(settings.deviation), torch.Generator().manual_seed(3)
    plan, previous = torch.zeros(STEPS, count), torch.full((count,), 0.1)
    for _ in range(2):  # the second one starts from the first
        wanted = reference(settings, *given(at, plan), previous=previous, generator=generator)
        found = device.improve(*given(at, plan), previous=previous)
        torch.testing.assert_close(found.controls, wanted.controls, atol=2e-3, rtol=0)
        torch.testing.assert_close(found.costs, wanted.costs, atol=1e-2, rtol=1e-3)
        assert abs(float(found.weights.sum()) - 1) < 1e-6
        plan = wanted.controls


@needs_gcc
def test_a_larger_map_and_another_length_of_plan_get_new_buffers():
    small, large = situation(layers(41), state=(-5.0, 1, 0.1, 4, 0, 0)), situation(ground())
    used = planner(small)
    for at, steps in ((small, 20), (large, 20), (small, 30), (large, 30)):
        used._generator.manual_seed(1)
        plans = [each.improve(*given(at, torch.zeros(steps, 2))).controls for each in (used, planner(small, seed=1))]
        assert torch.equal(*plans)


@needs_gcc
def test_where_no_sample_is_finite_it_says_so():
    at = situation(layers(), state=(float("nan"), 0, 0, 5, 0, 0))
    with pytest.raises(PlanningError, match="none of 128 sampled trajectories has a finite cost"):
        planner(at).improve(*given(at, torch.zeros(20, 2)))


@needs_gcc
@pytest.mark.parametrize(
    ("careful", "wrong", "said"),
    [
        (True, ("", ""), "costs on cpu differ from those on the CPU"),  # of kernels that know no spread
        (False, ("0.02f*yaw_rate", "0.04f*yaw_rate"), "costs on cpu differ from those on the CPU"),
        (False, ("+ i] = before = value;", "+ i] = before = 9.0f;"), "limits of controls on cpu differ"),
    ],
)
def test_kernels_that_compute_something_else_are_refused(careful, wrong, said):
    at = replace(SLOPE, caution=caution(DYNAMICS)) if careful else SLOPE
    check_planner(planner(at), *given(at, torch.zeros(40, 2)))
    with pytest.raises(PlanningError, match=said):
        check_planner(planner(wrong=wrong), *given(at, torch.zeros(40, 2)))


class Nothing:
    lanes = 1

    def launch(self, name, count, *arguments, lanes=1):
        raise AssertionError(name)


def test_maps_that_are_large_in_different_ways_do_not_take_turns_with_new_buffers():
    planner = DevicePlanner(Nothing(), DYNAMICS, SETTINGS, torch.Generator())
    wide, deep, wider = (tuple(torch.zeros(n) for n in sizes) for sizes in ((10, 3, 2), (2, 3, 10), (12, 3, 12)))
    given = torch.zeros(20, 2), torch.zeros(30)
    first, second = planner._buffers_for(*given, wide), planner._buffers_for(*given, deep)
    assert second is not first
    assert planner._buffers_for(*given, wide) is second
    assert (second.slope.numel(), second.layers.numel()) == (16, 16)
    assert planner._buffers_for(*given, wider) is second  # a map that grows by a little means no other graph
    assert [power_of_two(count) for count in (0, 1, 2, 3, 1024, 1025)] == [1, 1, 2, 4, 1024, 2048]


SMALL = situation(layers(41), state=(-5.0, 1, 0.1, 4, 0, 0))


@needs_gcc
def test_what_a_graph_reads_lives_as_long_as_the_graph():
    noises = []

    def capture(work, generator):
        noises.append(weakref.ref(work.args[1]))
        return lambda: None

    planned = planner(SMALL, capture=capture)
    planned.load(*given(SMALL, torch.zeros(20, 2)))
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

    planned, plain, arguments = planner(SMALL, capture=capture), planner(SMALL), given(SMALL, torch.zeros(20, 2))
    for turn in range(2):
        assert torch.equal(planned.improve(*arguments).controls, plain.improve(*arguments).controls)
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

    planned = planner(SMALL, capture=capture)
    for _ in range(2):
        with pytest.raises(PlanningError, match="a CUDA graph on cpu plans differently from its kernels"):
            planned.improve(*given(SMALL, torch.zeros(20, 2)))


@needs_gcc
def test_where_there_is_no_graph_no_plan_is_made_without():
    def capture(work, generator):
        raise PlanningError("no CUDA graph of a plan")

    planned = planner(SMALL, capture=capture)
    for _ in range(2):
        with pytest.raises(PlanningError, match="no CUDA graph"):
            planned.improve(*given(SMALL, torch.zeros(20, 2)))


@needs_gcc
def test_cells_are_copied_again_only_where_a_map_is_another_or_has_changed(monkeypatch):
    at, copied = situation(layers(41), state=(-5.0, 1, 0.1, 4, 0, 0)), []
    planned, (plan, model_state, _, weights, codes) = planner(at), given(at, torch.zeros(20, 2))
    monkeypatch.setattr("offpiste.planning.device_planner.into", lambda room, part: copied.append(room.copy_(part)))

    def copies(plan=plan):
        copied.clear()
        planned.load(plan, model_state, at, weights, codes)
        return len(copied) - 3  # plan, bounds and situation are always copied

    def slope_is_there():
        return torch.equal(planned._buffers.slope[: at.ground.slope.numel()], at.ground.slope.flatten())

    assert [copies(), copies()] == [3, 0]
    at.ground.slope.add_(0.1)
    assert copies() == 1
    assert slope_is_there()
    codes = codes[0].clone(), codes[1]
    assert copies() == 1
    copies(torch.zeros(30, 2))
    assert slope_is_there()
    with torch.inference_mode():
        codes = codes[0].clone(), codes[1]
    copies()
    assert copies() == 1


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_refused():
    with pytest.raises(PlanningError, match="no GPU 'cuda' for planning"):
        gpu_planner(model("b"), SETTINGS, situation(), "cuda", 0)
