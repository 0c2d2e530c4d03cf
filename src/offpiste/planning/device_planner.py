"""MPPI on a GPU as one CUDA graph: noise, limits, rollouts with costs, weights and mean; reference: `mppi.improve`.

The inputs of a plan are copied to fixed buffers, so that one captured graph serves all plans. A map larger than its
buffer requires new buffers and another graph, which is checked before its first plan.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final, final

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from offpiste.core.conventions import CONTROL
from offpiste.core.errors import PlanningError
from offpiste.core.state import ModelState
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.header.networks import packed_parameters
from offpiste.native.cuda_kernels import Kernels
from offpiste.planning.controls import bounds, controls_of
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.driving_cost import Situation
from offpiste.planning.header.costs import Maps, packed_maps, packed_situation
from offpiste.planning.kernel import Codes
from offpiste.planning.mppi import Plan, Settings, limited, no_finite_cost, rest_of, sample_groups
from offpiste.planning.noise import Noise, coefficient_sizes, coloured, from_coefficients, function_and_options

Capture = Callable[[Callable[[], None], Generator], Callable[[], None]]
"""Function that captures work with random numbers of a generator (`captured`)."""

TOLERANCE: Final = 1e-3
"""Largest accepted difference of plans, and of the median relative difference of costs.

Single samples diverge where rounding selects another cell."""

HOW: Final = "plan on the CPU, and report GPU, driver and this line"

_Versions = tuple[tuple[Tensor | None, int | None], ...]

_NOTHING: Final[_Versions] = ((None, None),) * 3


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


@final
class DevicePlanner:
    """MPPI for one model on one device.

    Args:
        kernels: of `plan_text`, for this model and the layers of the cost map.
        settings: for pedal and steer, or for throttle, brake and steer.
        generator: source of the noise, on the device of the kernels.
        capture: captures the work of a plan as a graph, if its noise allows that; None for no graph.

    Attributes:
        device: device of the computation.
    """

    def __init__(
        self, kernels: Kernels, dynamics: Dynamics, settings: Settings, generator: Generator,
        capture: Capture | None = None,
    ) -> None:  # fmt: skip
        self.kernels, self.dynamics, self.settings, self._generator = kernels, dynamics, settings, generator
        self.device, self._capture = generator.device, capture
        self._params = packed_parameters(dynamics).to(self.device)
        self._scale, self._fresh, self._rest = (part.to(self.device) for part in _groups(settings))
        self._buffers: Buffers | None = None
        self._copied: _Versions = _NOTHING
        # The graph reads memory owned by the work, such as the spectrum of the noise, so both are kept.
        self._work: Callable[[], None] = lambda: None
        self._graph: Callable[[], None] | None = None
        self._unchecked = False

    @torch.no_grad()
    def improve(
        self,
        controls: Float[Tensor, "T U"],
        model_state: ModelState,
        situation: Situation,
        weights: CostWeights,
        codes: Codes,
        *,
        previous: Float[Tensor, " U"] | None = None,
    ) -> Plan:
        """Improve a plan, as `mppi.improve`; all arguments and results are on the CPU.

        Raises:
            NoPlan: no sample has a finite cost.
            PlanningError: a new graph differs from its work.
        """
        self.load(controls, model_state, situation, weights, codes, previous=previous)
        assert self._buffers is not None
        if self._graph is not None and self._unchecked:
            self._unchecked = not is_same(self._work, self._graph, self._generator, self._buffers)
        (self._graph or self._work)()
        plan, costs, shares = outcome(self._buffers)
        if not costs.isfinite().any():
            raise no_finite_cost(len(costs))
        plan = limited(plan[None], self.settings, previous)[0]
        return Plan(plan, costs, shares)

    @torch.no_grad()
    def load(
        self, controls: Float[Tensor, "T U"], model_state: ModelState, situation: Situation, weights: CostWeights,
        codes: Codes, *, previous: Float[Tensor, " U"] | None = None,
    ) -> None:  # fmt: skip
        """Copy the inputs of planning to the device; skip maps whose tensors have not changed since the last call."""
        packed = packed_situation(self.dynamics, model_state, situation, weights, codes)
        maps = packed_maps(situation, codes, torch.device("cpu"))
        buffers = self._buffers_for(controls, packed, maps)
        into(buffers.plan, controls)
        into(buffers.bounds, bounds_of(self.settings, previous))
        into(buffers.situation, packed)
        rooms = buffers.slope, buffers.codes, buffers.layers
        # Tensors of inference mode have no version and are always copied.
        given = tuple(
            (cells, None if cells.is_inference() else cells._version)
            for cells in (situation.ground.slope, codes[0], situation.costs.layers)
        )
        for room, part, new, old in zip(rooms, maps, given, self._copied, strict=True):
            if new[0] is not old[0] or new[1] is None or new[1] != old[1]:
                into(room[: part.numel()], part.flatten())
        self._copied = given

    def _buffers_for(self, controls: Tensor, packed: Tensor, maps: Maps) -> Buffers:
        """Return the buffers, or new ones with new work if the plan or its maps do not fit."""
        held = self._buffers
        rooms = () if held is None else (held.slope, held.codes, held.layers)
        fits = all(part.numel() <= room.numel() for part, room in zip(maps, rooms, strict=False))
        if held is not None and fits and held.plan.shape == controls.shape:
            return held
        new = partial(torch.zeros, device=self.device)
        samples, held_sizes = self.settings.samples, [room.numel() for room in rooms] or [0] * len(maps)
        # Buffers never shrink, so that maps of different shapes share them, and have spare room for growing maps.
        sizes = (max(power_of_two(part.numel()), size) for part, size in zip(maps, held_sizes, strict=True))
        slope, code, layers = (new(size) for size in sizes)
        costs, shares = (new(samples, dtype=torch.float64) for _ in range(2))
        plan, bounds = new(controls.shape), new(4, controls.shape[1])
        buffers = Buffers(plan, bounds, new(len(packed)), slope, code, layers, costs, shares)
        noise = prepared(self.settings.noise, len(controls), self.device)
        self._work = partial(self._iterate, buffers, noise or self.settings.noise)
        self._buffers, self._graph, self._copied = None, None, _NOTHING
        if noise and self._capture is not None:
            self._graph, self._unchecked = self._capture(self._work, self._generator), True
        self._buffers = buffers  # only after a successful capture
        return buffers

    def _iterate(self, b: Buffers, noise: Noise) -> None:
        """Run all iterations of a plan on the buffers, without synchronisation."""
        settings, (steps, count) = self.settings, b.plan.shape
        for _ in range(settings.iterations):
            drawn = noise((settings.samples, steps, count), self._generator, torch.float32) * self._scale
            draws = drawn + self._fresh * self._rest + (1 - self._fresh) * b.plan
            by_step = draws.permute(1, 2, 0).contiguous()
            items = count * settings.samples
            self.kernels.launch("offpiste_keep_within", items, by_step, b.bounds, count, steps)
            given = model_controls(by_step.permute(2, 0, 1)).permute(1, 2, 0).contiguous()
            costs = b.costs.new_empty(settings.samples, dtype=torch.float32)
            self.kernels.launch(
                "offpiste_roll_out", settings.samples, self._params, b.situation, b.slope, b.codes, b.layers, given,
                costs, None, steps, lanes=self.kernels.lanes,
            )  # fmt: skip
            b.costs.copy_(costs)
            finite = b.costs.masked_fill(~b.costs.isfinite(), torch.inf)
            b.weights.copy_(torch.softmax((finite.min() - finite) / settings.temperature, dim=0))
            b.plan.copy_(torch.einsum("k,tuk->tu", b.weights.float(), by_step))


def model_controls(sampled: Float[Tensor, "K T U"]) -> Float[Tensor, "K T 3"]:
    """Return throttle, brake and steer from those or from pedal and steer."""
    return sampled if sampled.shape[-1] == len(CONTROL) else controls_of(sampled)


def prepared(noise: Noise, steps: int, device: torch.device) -> Noise | None:
    """Return `coloured` noise without copies from the CPU, which a graph cannot hold; None for other noise."""
    function, options = function_and_options(noise)
    if function is not coloured:
        return None
    size = coefficient_sizes(steps, **options).to(device, torch.float32)
    period = options.get("period") or 2 * steps
    return lambda shape, generator, dtype: from_coefficients(shape, generator, size, period)


def into(buffer: Tensor, values: Tensor) -> None:
    """Copy values from the CPU; asynchronously to a GPU."""
    if buffer.device.type == "cuda":
        buffer.copy_(values.pin_memory(), non_blocking=True)
    else:
        buffer.copy_(values)


def power_of_two(count: int) -> int:
    """Return the smallest power of two not below a count."""
    return 1 << max(count - 1, 0).bit_length()


def _groups(settings: Settings) -> tuple[Float[Tensor, "K 1 U"], Float[Tensor, "K 1 1"], Float[Tensor, " U"]]:
    """Return the noise factors of the samples, whether they are fresh, and the controls at rest (`mppi.sample`)."""
    factor, is_fresh = torch.ones(settings.samples), torch.zeros(settings.samples)
    for group in sample_groups(settings):
        factor[group.samples], is_fresh[group.samples] = group.factor, float(group.fresh)
    deviation = torch.tensor(settings.deviation)
    rest = rest_of(settings, deviation)
    return factor[:, None, None] * deviation, is_fresh[:, None, None], rest


def bounds_of(settings: Settings, previous: Tensor | None) -> Float[Tensor, "4 U"]:
    """Return low and high bounds, the largest change per step, and the previous control (NaN for none)."""
    low, high, change = bounds(settings.limits, settings.dt, torch.empty(0))
    before = torch.full_like(low, torch.nan) if previous is None else previous.float()
    return torch.stack((low, high, change, before))


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
