"""The work of a plan as one CUDA graph, and its check against the same work without one."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import torch
from torch import Generator, Tensor

from offpiste.core.errors import PlanningError

Capture = Callable[[Callable[[], None], Generator], Callable[[], None]]
"""Turns a function into one that repeats its work, new random numbers of the generator each time (`captured`)."""

APART: Final = 1e-3
"""Largest difference of plans, and median of the relative differences of costs: single samples part where rounding
chooses another cell."""

HOW: Final = "plan on the CPU, and report GPU, driver and this line"


@dataclass(frozen=True)
class Buffers:
    """Where the graph finds a plan's inputs, and leaves its outcome.

    Attributes:
        plan: mean of the samples [T, U].
        bounds: low, high, largest change of a step and control before the first [4, U].
        situation: see `packed_situation`.
        slope, codes, layers: cells of the maps, and room for larger ones.
        costs, weights: of the samples.
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
    """What replays a function's work on the GPU as one graph, new random numbers each time.

    Raises:
        PlanningError: the GPU makes no graph of it.
    """
    device, graph = generator.device, torch.cuda.CUDAGraph()
    try:
        warm = torch.cuda.Stream(device)
        warm.wait_stream(torch.cuda.current_stream(device))
        with torch.cuda.stream(warm):  # libraries allocate and compile at their first call, which a graph cannot hold
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
    """Mean, costs and weights of a plan, copied to the CPU."""
    plan, costs, shares = (part.to("cpu", copy=True) for part in (buffers.plan, buffers.costs, buffers.weights))
    return plan, costs, shares


def is_same(work: Callable[[], None], graph: Callable[[], None], generator: Generator, buffers: Buffers) -> bool:
    """Compare a graph with the work it was made of, twice, and write over free memory in between.

    Plan and generator are afterwards as they were before.

    Returns:
        False where no sample has a finite cost, which leaves nothing to compare.

    Raises:
        PlanningError: they differ.
    """
    drawn, plan, outcomes = generator.get_state(), buffers.plan.clone(), []
    for run in (work, graph, graph):
        generator.set_state(drawn)
        buffers.plan.copy_(plan)
        run()
        outcomes.append(outcome(buffers))
        _write_over_free_memory(plan.device)
    generator.set_state(drawn)
    buffers.plan.copy_(plan)
    wanted, *found = outcomes
    if not wanted[1].isfinite().any():
        return False
    apart = float(torch.tensor([_apart(each, wanted) for each in found]).max())  # NaN where one is
    if not apart < APART:
        what = f"a CUDA graph on {plan.device} plans otherwise than the kernels that it is made of, by {apart:.1e}"
        raise PlanningError(what, how=HOW)
    return True


def _write_over_free_memory(device: torch.device) -> None:
    """Fill what was freed with NaN, in sizes up to 2 MB: a graph that still reads it comes to nothing."""
    free = [torch.full((1 << size,), torch.nan, device=device) for size in range(6, 20) for _ in range(4)]
    del free


def _apart(found: tuple[Tensor, Tensor, Tensor], wanted: tuple[Tensor, Tensor, Tensor]) -> float:
    """Largest difference of plans and weights, and the median of the relative one of costs; NaN where one has it."""
    plans, costs, shares = zip(found, wanted, strict=True)
    finite = costs[1].isfinite()
    if not torch.equal(costs[0].isfinite(), finite):
        return torch.nan
    relative = ((costs[0] - costs[1]).abs() / costs[1].abs().clamp(min=1e-6))[finite].median()
    largest = [(a - b).abs().max().double() for a, b in (plans, shares)]
    return float(torch.stack((relative, *largest)).max())
