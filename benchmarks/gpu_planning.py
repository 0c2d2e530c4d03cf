"""Stages of gpu.py: plans and features of images on a GPU."""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import plan as on_cpu
import torch
from gpu_timing import Row, by_events, open_kernels, timed
from torch import Tensor

from offpiste.core.conventions import HORIZON_STEPS
from offpiste.core.state import ModelState
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.feature_encoder import FeatureEncoder
from offpiste.mapping.replay import ExtractFeatures
from offpiste.mapping.terrain_sampler import stack_maps
from offpiste.planning.caution import Caution
from offpiste.planning.controls import PEDAL_LIMITS
from offpiste.planning.costs.layers import Hazards, cost_map
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.course import Course
from offpiste.planning.device_planner import DevicePlanner, captured
from offpiste.planning.driving_cost import Situation
from offpiste.planning.gpu import check_planner
from offpiste.planning.header.cost_text import plan_text
from offpiste.planning.header.costs import costs_by_kernels
from offpiste.planning.kernel import encode_map
from offpiste.planning.mppi import Settings
from offpiste.runtime.perception import codes_of, encoder_on
from offpiste.runtime.planner import load_planner
from offpiste.training.run import load_run
from offpiste.uncertainty.fit import load_spread

SAME_CODES = 1e-4
"""Largest difference of codes of an image on two devices."""


def situation() -> Situation:
    """The map of benchmarks/plan.py."""
    layers = on_cpu.ground()
    course = Course(np.array([[-20.0, 0], [20, 3], [55, -4]]), np.full(3, 6.0))
    return Situation(
        stack_maps([layers.terrain_map()]), cost_map(layers, course, Hazards()), on_cpu.WHEELS,
        torch.zeros(2, dtype=torch.float64), torch.tensor([-10.0, 0.5, 0.2, 5, 0, 0]), torch.zeros(3),
    )  # fmt: skip


class Plans:
    """Plans of the shipped model in one situation, on a device.

    Args:
        given: options of gpu.py; `small` plans are made without a graph, since memcheck follows kernels themselves.
        caution: how much the spread counts.
    """

    def __init__(
        self, dynamics: Dynamics, device: torch.device, given: argparse.Namespace, caution: Caution | None = None
    ) -> None:
        self.dynamics, self.device, self.at = dynamics, device, replace(situation(), caution=caution)
        self.weights, self.codes = CostWeights(path=5.0), encode_map(self.at.ground, dynamics.encoder)
        units = torch.zeros(1, dynamics.recurrent_size)
        self.start = ModelState(self.at.state[None], torch.tensor([[0.0, 0.0, 0.0, 1.0]]), units)
        on_gpu = device.type == "cuda"
        self.kernels = open_kernels(plan_text(dynamics, self.at.costs.table, caution, lanes=on_gpu), device)
        self.capture = captured if on_gpu and not given.small else None
        self.samples = [90] if given.small else [1024, 8192]
        self.taken = (torch.zeros(HORIZON_STEPS, 2), self.start, self.at, self.weights, self.codes)

    def planner(self, samples: int) -> DevicePlanner:
        """A planner of so many samples."""
        settings = Settings(PEDAL_LIMITS, (0.15, 0.15), samples=samples, temperature=3.0, rest=(0.4, 0.0))
        generator = torch.Generator(self.device).manual_seed(0)
        return DevicePlanner(self.kernels, self.dynamics, settings, generator, self.capture)

    def rollouts(self, samples: int) -> Callable[[], Tensor]:
        """Rolls out so many random controls; their costs."""
        there = ModelState(*(part.to(self.device) for part in vars(self.start).values()))
        cost_of = costs_by_kernels(self.kernels, self.dynamics, there, self.at, self.weights, self.codes)
        drawn = torch.rand(samples, HORIZON_STEPS, 3, generator=torch.Generator().manual_seed(1))
        controls = (0.3 * drawn).to(self.device)
        return lambda: cost_of(controls)


def of_plans(dynamics: Dynamics, device: torch.device, given: argparse.Namespace) -> Iterator[Row]:
    """Rollouts with map and cost, whole plans, and what is packed and copied for them."""
    plans, turns = Plans(dynamics, device, given), given.turns
    for turn, samples in enumerate(plans.samples):
        planner, roll, size = plans.planner(samples), plans.rollouts(samples), f"{samples} x {HORIZON_STEPS}"
        if turn == 0:
            check_planner(planner, *plans.taken)
            yield {"what": "costs and limits agree with the CPU's"}
        yield timed(f"rollouts with map and cost, {size}", roll, device, turns)
        if device.type == "cuda":
            yield by_events(f"rollouts by events of the GPU, {size}", roll, turns)
        yield timed(f"a whole plan of one iteration, {size}", partial(planner.improve, *plans.taken), device, turns)
        if plans.capture:
            yield {"what": f"the graph of {samples} samples plans as its kernels do"}
        if turn == 0:
            load = partial(planner.load, *plans.taken)
            yield timed("packing and copying, the map of the last plan", load, device, turns)
            yield timed("packing and copying, another map", loads_of_other_maps(plans, planner, turns), device, turns)


def loads_of_other_maps(plans: Plans, planner: DevicePlanner, turns: int) -> Callable[[], None]:
    """Hands over a map that has not been there before, each time."""
    others = [situation() for _ in range(turns + 2)]
    plan, (codes, missing) = plans.taken[0], plans.codes

    def load() -> None:
        planner.load(plan, plans.start, others.pop(), plans.weights, (codes.clone(), missing))

    return load


def of_spread(dynamics: Dynamics, device: torch.device, given: argparse.Namespace) -> Iterator[Row]:
    """Plans of which the predictions' spread counts a part: they agree with the CPU's, and what they take."""
    plans = Plans(dynamics, device, given, Caution(load_spread(load_run("pretrained:proving-ground/dc")), 1.0))
    for samples in plans.samples:
        planner, size = plans.planner(samples), f"{samples} x {HORIZON_STEPS}"
        check_planner(planner, *plans.taken)
        yield {"what": f"costs of {samples} samples agree with the CPU's, spread included"}
        yield timed(f"rollouts with spread, {size}", plans.rollouts(samples), device, given.turns)
        yield timed(f"a plan with spread, {size}", partial(planner.improve, *plans.taken), device, given.turns)


def of_images(dynamics: Dynamics, device: torch.device, given: argparse.Namespace) -> Iterator[Row]:
    """Images to codes as the run time computes them: they agree with the CPU's, and what they take on both."""
    height, width = (140, 280) if given.small else (560, 1120)
    pixels, codes = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8), []
    for place in ("cpu", str(device)):
        planner = load_planner("pretrained:proving-ground/dc", device=place)
        assert planner.extractor is not None
        encoder = encoder_on(place, planner.dynamics.encoder)
        assert encoder is not None

        def encode(extract: ExtractFeatures = planner.extractor.extract, encoder: FeatureEncoder = encoder) -> None:
            codes.append(codes_of(pixels, extract, encoder))

        size = f"{height} x {width} pixels"
        yield timed(
            f"an image of {size} to codes by {planner.extractor.backbone.name}, {place}", encode, device, given.turns
        )
    apart = float(np.abs(codes[-1] - codes[0]).max())
    if not apart < SAME_CODES:
        raise SystemExit(f"codes of an image differ by {apart:.1e} between the CPU and {device}")
    yield {"what": f"codes are within {apart:.0e} of the CPU's"}
