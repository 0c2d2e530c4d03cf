"""MPPI whose samples never leave a GPU: noise, limits, rollouts with costs, weights and mean, as one CUDA graph.

`mppi.improve` is its reference. What a plan depends on lies in buffers that stay where they are, so that the graph,
captured once, serves all plans; a map that is larger than all before it means new buffers, and another graph.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, final

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from offpiste.conventions import CONTROL
from offpiste.cuda_kernels import Kernels
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.header.networks import packed_parameters
from offpiste.errors import PlanningError
from offpiste.planning.constraints import bounds
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.driving_cost import Situation
from offpiste.planning.header.costs import packed_maps, packed_situation
from offpiste.planning.kernel import Codes
from offpiste.planning.mppi import Plan, Settings, limited, no_finite_cost, rest_of, sample_groups, smoothed
from offpiste.planning.noise import Noise, coefficient_sizes, coloured, from_coefficients, function_and_options
from offpiste.planning.pedal import controls_of
from offpiste.state import ModelState


@dataclass(frozen=True)
class _Buffers:
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


@final
class DevicePlanner:
    """Plans of one model on one device.

    Args:
        kernels: of `plan_text`, for this model and the layers of the cost map.
        settings: of pedal and steering, or of throttle, brake and steering.
        generator: source of the noise, on the device where the kernels run.

    Attributes:
        kernels, dynamics, settings: as given.
        device: that plans are computed on.

    Raises:
        PlanningError: a control cost, which only `mppi.improve` has.
    """

    def __init__(self, kernels: Kernels, dynamics: Dynamics, settings: Settings, generator: Generator) -> None:
        if settings.control_cost:
            raise PlanningError("a control cost is not computed on a GPU", how="set it to 0, or plan on the CPU")
        self.kernels, self.dynamics, self.settings, self._generator = kernels, dynamics, settings, generator
        self.device = generator.device
        self._params = packed_parameters(dynamics).to(self.device)
        self._scale, self._fresh, self._rest = (part.to(self.device) for part in _groups(settings))
        self._buffers: _Buffers | None = None
        self._run: Callable[[], None] = lambda: None

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
        """Improve a plan, as `mppi.improve`; all that is given and returned lies on the CPU.

        Raises:
            PlanningError: no sample has a finite cost.
        """
        settings = self.settings
        packed = packed_situation(self.dynamics, model_state, situation, weights, codes)
        maps = packed_maps(situation, codes, torch.device("cpu"))
        buffers = self._buffers_for(controls, packed, maps)
        buffers.plan.copy_(controls)
        buffers.bounds.copy_(bounds_of(settings, previous))
        buffers.situation.copy_(packed)
        for room, part in zip((buffers.slope, buffers.codes, buffers.layers), maps, strict=True):
            room[: part.numel()].copy_(part.flatten())
        self._run()
        plan, costs, shares = buffers.plan.cpu(), buffers.costs.cpu(), buffers.weights.cpu()
        if not costs.isfinite().any():
            raise no_finite_cost(len(costs))
        plan = limited(smoothed(plan, settings.smoothing)[None], settings, previous)[0]
        return Plan(plan, costs, shares)

    def _buffers_for(self, controls: Tensor, packed: Tensor, maps: tuple[Tensor, Tensor, Tensor]) -> _Buffers:
        """The buffers, where the plan and its maps fit; else new ones, and what runs on them."""
        held = self._buffers
        rooms = () if held is None else (held.slope, held.codes, held.layers)
        fits = all(part.numel() <= room.numel() for part, room in zip(maps, rooms, strict=False))
        if held is not None and fits and held.plan.shape == controls.shape:
            return held
        new = partial(torch.zeros, device=self.device)
        samples, held_sizes = self.settings.samples, [room.numel() for room in rooms] or [0] * len(maps)
        # As large as any map so far, so that maps that are large in different ways do not take turns.
        slope, code, layers = (new(max(part.numel(), size)) for part, size in zip(maps, held_sizes, strict=True))
        costs, shares = (new(samples, dtype=torch.float64) for _ in range(2))
        plan, bounds = new(controls.shape), new(4, controls.shape[1])
        self._buffers = _Buffers(plan, bounds, new(len(packed)), slope, code, layers, costs, shares)
        noise = prepared(self.settings.noise, len(controls), self.device)
        run = partial(self._iterate, self._buffers, noise or self.settings.noise)
        self._run = captured(run, self._generator) if noise and self.device.type == "cuda" else run
        return self._buffers

    def _iterate(self, b: _Buffers, noise: Noise) -> None:
        """All iterations of a plan, from buffers to buffers, without waiting for the device."""
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
                costs, None, steps,
            )  # fmt: skip
            b.costs.copy_(costs)
            finite = torch.where(b.costs.isfinite(), b.costs, torch.inf)
            b.weights.copy_(torch.softmax((finite.min() - finite) / settings.temperature, dim=0))
            b.plan.copy_(torch.einsum("k,tuk->tu", b.weights.float(), by_step))


def model_controls(sampled: Float[Tensor, "K T U"]) -> Float[Tensor, "K T 3"]:
    """Throttle, brake and steer, from those or from pedal and steer."""
    return sampled if sampled.shape[-1] == len(CONTROL) else controls_of(sampled)


def prepared(noise: Noise, steps: int, device: torch.device) -> Noise | None:
    """`coloured` noise without copies from the CPU, which a graph cannot hold; None for other noise."""
    function, options = function_and_options(noise)
    if function is not coloured:
        return None
    size = coefficient_sizes(steps, **options).to(device, torch.float32)
    period = options.get("period") or 2 * steps
    return lambda shape, generator, dtype: from_coefficients(shape, generator, size, period)


def captured(run: Callable[[], None], generator: Generator) -> Callable[[], None]:
    """What replays a function's work on the GPU as one graph, new random numbers each time."""
    warm = torch.cuda.Stream(generator.device)
    warm.wait_stream(torch.cuda.current_stream(generator.device))
    with torch.cuda.stream(warm):  # libraries allocate and compile at their first call, which a graph cannot hold
        for _ in range(2):
            run()
    torch.cuda.current_stream(generator.device).wait_stream(warm)
    graph: Any = torch.cuda.CUDAGraph()
    graph.register_generator_state(generator)
    with torch.cuda.graph(graph):
        run()
    return graph.replay  # type: ignore[no-any-return]


def _groups(settings: Settings) -> tuple[Float[Tensor, "K 1 U"], Float[Tensor, "K 1 1"], Float[Tensor, " U"]]:
    """Factors of the noise of each sample, which samples are fresh, and what those lie around (`mppi.sample`)."""
    factor, is_fresh = torch.ones(settings.samples), torch.zeros(settings.samples)
    for group in sample_groups(settings):
        factor[group.samples], is_fresh[group.samples] = group.factor, float(group.fresh)
    deviation = torch.tensor(settings.deviation)
    rest = rest_of(settings, deviation)
    return factor[:, None, None] * deviation, is_fresh[:, None, None], rest


def bounds_of(settings: Settings, previous: Tensor | None) -> Float[Tensor, "4 U"]:
    """Low and high bounds, largest change of a step, control before the first; NaN leaves that one free."""
    low, high, change = bounds(settings.limits, settings.dt, torch.empty(0))
    before = torch.full_like(low, torch.nan) if previous is None else previous.float()
    return torch.stack((low, high, change, before))
