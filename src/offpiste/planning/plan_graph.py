"""Capture of the work of a plan as a CUDA graph, and its check against the same work without a graph."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import torch
from torch import Generator, Tensor

from offpiste.core.errors import PlanningError

Capture = Callable[[Callable[[], None], Generator], Callable[[], None]]
"""Function that captures work with random numbers of a generator (`captured`)."""

TOLERANCE: Final = 1e-3
"""Largest accepted difference of plans, and of the median relative difference of costs.

Single samples diverge where rounding selects another cell."""

HOW: Final = "plan on the CPU, and report GPU, driver and this line"


@dataclass(frozen=True)
class Buffers:
    """Inputs and results of a plan.

    Attributes:
        plan: mean of the samples [T, U].
        bounds: low, high, largest change per step and previous control [4, U].
        situation: `packed_situation`.
        slope, codes, layers: cells of the maps, with spare room.
        costs, weights: costs and weights of the samples.
    """

    plan: Tensor
    bounds: Tensor
    situation: Tensor
    slope: Tensor
    codes: Tensor
    layers: Tensor
    costs: Tensor
    weights: Tensor


def captured(run: Callable[[], None], generator: Generator) -> Callable[[], None]:
    """Capture the work of a function as a graph that draws new random numbers at each replay.

    Raises:
        PlanningError: the capture fails.
    """
    device, graph = generator.device, torch.cuda.CUDAGraph()
    try:
        warm = torch.cuda.Stream(device)
        warm.wait_stream(torch.cuda.current_stream(device))
        with torch.cuda.stream(warm):  # libraries allocate and compile in their first call, outside the graph
            for _ in range(2):
                run()
        torch.cuda.current_stream(device).wait_stream(warm)
        graph.register_generator_state(generator)
        with torch.cuda.device(device), torch.cuda.graph(graph):
            run()
    except RuntimeError as error:
        raise PlanningError(f"no CUDA graph of a plan: {error}", how=HOW) from error
    replay: Callable[[], None] = graph.replay
    return replay


def outcome(buffers: Buffers) -> tuple[Tensor, Tensor, Tensor]:
    """Copy mean, costs and weights of a plan to the CPU."""
    plan, costs, shares = (part.to("cpu", copy=True) for part in (buffers.plan, buffers.costs, buffers.weights))
    return plan, costs, shares


def is_same(work: Callable[[], None], graph: Callable[[], None], generator: Generator, buffers: Buffers) -> bool:
    """Compare a graph twice with its work, overwriting free memory in between; plan and generator are restored.

    Returns:
        False if no sample has a finite cost, and nothing can be compared.

    Raises:
        PlanningError: they differ.
    """
    drawn, plan, outcomes = generator.get_state(), buffers.plan.clone(), []
    for run in (work, graph, graph):
        generator.set_state(drawn)
        buffers.plan.copy_(plan)
        run()
        outcomes.append(outcome(buffers))
        _overwrite_free_memory(plan.device)
    generator.set_state(drawn)
    buffers.plan.copy_(plan)
    wanted, *found = outcomes
    if not wanted[1].isfinite().any():
        return False
    difference = float(torch.tensor([_difference(each, wanted) for each in found]).max())  # NaN where one is
    if not difference < TOLERANCE:
        what = f"a CUDA graph on {plan.device} plans differently from its kernels, by {difference:.1e}"
        raise PlanningError(what, how=HOW)
    return True


def _overwrite_free_memory(device: torch.device) -> None:
    """Fill free memory with NaN in blocks of up to 2 MB, to expose graphs that read freed memory."""
    free = [torch.full((1 << size,), torch.nan, device=device) for size in range(6, 20) for _ in range(4)]
    del free


def _difference(found: tuple[Tensor, Tensor, Tensor], wanted: tuple[Tensor, Tensor, Tensor]) -> float:
    """Return the largest difference of plans, weights and (median, relative) costs; NaN propagates."""
    plans, costs, shares = zip(found, wanted, strict=True)
    finite = costs[1].isfinite()
    if not torch.equal(costs[0].isfinite(), finite):
        return torch.nan
    relative = ((costs[0] - costs[1]).abs() / costs[1].abs().clamp(min=1e-6))[finite].median()
    largest = [(a - b).abs().max().double() for a, b in (plans, shares)]
    return float(torch.stack((relative, *largest)).max())
