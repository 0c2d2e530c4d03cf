"""Stages of gpu.py: what the run time does on a GPU, and what other software takes for the same."""

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import plan as on_cpu
import torch
from gpu_timing import Row, by_events, open_kernels, timed
from torch import Tensor

from offpiste.closed_loop.planner import load_planner
from offpiste.conventions import HORIZON_STEPS
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.feature_encoder import FeatureEncoder
from offpiste.mapping.replay import ExtractFeatures
from offpiste.mapping.terrain_sampler import stack_maps
from offpiste.planning.caution import Caution
from offpiste.planning.cost_map import cost_map
from offpiste.planning.costs.layers import Hazards
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.course import Course
from offpiste.planning.device_planner import DevicePlanner
from offpiste.planning.driving_cost import Situation
from offpiste.planning.gpu import check_planner
from offpiste.planning.header.cost_text import plan_text
from offpiste.planning.header.costs import costs_by_kernels
from offpiste.planning.kernel import encode_map
from offpiste.planning.mppi import PEDALS_AND_WHEEL, Settings, limited, sample
from offpiste.planning.pedal import PEDAL_AND_WHEEL
from offpiste.planning.plan_graph import captured
from offpiste.runtime.perception import codes_of, encoder_on
from offpiste.state import ModelState
from offpiste.training.run import pretrained
from offpiste.uncertainty.prediction import load_spread

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


def of_plans(dynamics: Dynamics, device: torch.device, given: argparse.Namespace) -> Iterator[Row]:
    """Rollouts with map and cost, whole plans, and what is packed and copied for them."""
    small, turns = given.small, given.turns
    at, weights = situation(), CostWeights(path=5.0)
    codes = encode_map(at.ground, dynamics.encoder)
    units = torch.zeros(1, dynamics.recurrent_size)
    start = ModelState(at.state[None], torch.tensor([[0.0, 0.0, 0.0, 1.0]]), units, units)
    there = ModelState(*(part.to(device) for part in vars(start).values()))
    kernels = open_kernels(plan_text(dynamics, at.costs.table, lanes=device.type == "cuda"), device)
    # memcheck follows the kernels themselves, not a graph of them.
    capture = captured if device.type == "cuda" and not small else None
    plan = torch.zeros(HORIZON_STEPS, 2)
    for turn, samples in enumerate([90] if small else [1024, 8192]):
        settings = Settings(PEDAL_AND_WHEEL, (0.15, 0.15), samples=samples, temperature=3.0, rest=(0.4, 0.0))
        generator = torch.Generator(device).manual_seed(0)
        planner = DevicePlanner(kernels, dynamics, settings, generator, capture)
        taken, size = (plan, start, at, weights, codes), f"{samples} x {HORIZON_STEPS}"
        if turn == 0:
            check_planner(planner, *taken)
            yield {"what": "costs and limits agree with the CPU's"}
        cost_of = costs_by_kernels(kernels, dynamics, there, at, weights, codes)
        controls = (0.3 * torch.rand(samples, HORIZON_STEPS, 3, generator=torch.Generator().manual_seed(1))).to(device)
        yield timed(f"rollouts with map and cost, {size}", lambda c=cost_of, u=controls: c(u), device, turns)
        if device.type == "cuda":
            yield by_events(f"rollouts by events of the GPU, {size}", lambda c=cost_of, u=controls: c(u), turns)
        yield timed(f"a whole plan of one iteration, {size}", lambda p=planner, g=taken: p.improve(*g), device, turns)
        if capture:
            yield {"what": f"the graph of {samples} samples plans as its kernels do"}
        if turn == 0:
            yield timed(
                "packing and copying, the map of the last plan", lambda p=planner, g=taken: p.load(*g), device, turns
            )
            others = [situation() for _ in range(turns + 2)]

            def load(planner: DevicePlanner = planner, others: list[Situation] = others) -> None:
                at = others.pop()
                planner.load(plan, start, at, weights, (codes[0].clone(), codes[1]))

            yield timed("packing and copying, another map", load, device, turns)


def of_spread(dynamics: Dynamics, device: torch.device, given: argparse.Namespace) -> Iterator[Row]:
    """Plans of which the predictions' spread counts a part: they agree with the CPU's, and what they take."""
    caution = Caution(load_spread(pretrained("proving-ground/dc")), 1.0)
    at, weights = replace(situation(), caution=caution), CostWeights(path=5.0)
    codes, units = encode_map(at.ground, dynamics.encoder), torch.zeros(1, dynamics.recurrent_size)
    start = ModelState(at.state[None], torch.tensor([[0.0, 0.0, 0.0, 1.0]]), units, units)
    there = ModelState(*(part.to(device) for part in vars(start).values()))
    kernels = open_kernels(plan_text(dynamics, at.costs.table, caution, lanes=device.type == "cuda"), device)
    plan = torch.zeros(HORIZON_STEPS, 2)
    for samples in [90] if given.small else [1024, 8192]:
        settings = Settings(PEDAL_AND_WHEEL, (0.15, 0.15), samples=samples, temperature=3.0, rest=(0.4, 0.0))
        capture = captured if device.type == "cuda" and not given.small else None
        planner = DevicePlanner(kernels, dynamics, settings, torch.Generator(device).manual_seed(0), capture)
        taken, size = (plan, start, at, weights, codes), f"{samples} x {HORIZON_STEPS}"
        check_planner(planner, *taken)
        yield {"what": f"costs of {samples} samples agree with the CPU's, spread included"}
        cost_of = costs_by_kernels(kernels, dynamics, there, at, weights, codes)
        controls = (0.3 * torch.rand(samples, HORIZON_STEPS, 3, generator=torch.Generator().manual_seed(1))).to(device)
        yield timed(f"rollouts with spread, {size}", lambda c=cost_of, u=controls: c(u), device, given.turns)
        yield timed(f"a plan with spread, {size}", lambda p=planner, g=taken: p.improve(*g), device, given.turns)


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


def moved(at: Situation, codes: tuple[Tensor, Tensor], device: torch.device) -> Situation:
    """A situation with a map of codes, on a device."""
    at = on_cpu.codes_first(at, codes)
    ground, costs = at.ground, at.costs
    there = {
        "origin": ground.origin.to(device),
        "slope": ground.slope.to(device),
        "features": ground.features.to(device),
    }
    return replace(
        at, ground=replace(ground, **there), costs=replace(costs, **on_device(costs, device)), **on_device(at, device)
    )


def on_device(item: object, device: torch.device) -> dict[str, Tensor]:
    """The fields of a dataclass that are tensors, on a device."""
    return {name: value.to(device) for name, value in vars(item).items() if isinstance(value, Tensor)}


def of_pytorch_mppi(dynamics: Dynamics, device: torch.device, given: argparse.Namespace) -> Iterator[Row]:
    """The same rollouts with map and cost by the kernels and by pytorch_mppi, step by step and compiled."""
    small, turns = given.small, given.turns
    samples, weights = 90 if small else 1024, CostWeights()
    at, model = situation(), on_cpu.network("dc")
    codes = encode_map(at.ground, model.encoder)
    settings = Settings(PEDALS_AND_WHEEL, (0.3, 0.1, 0.3), samples=samples)
    drawn = sample(torch.tensor([0.3, 0.0, 0.0]).repeat(HORIZON_STEPS, 1), settings, torch.Generator().manual_seed(0))
    controls = limited(drawn, settings, at.control).to(device)
    begin = on_cpu.start(model, at)
    there = ModelState(*(part.to(device) for part in vars(begin).values()))
    kernels = open_kernels(plan_text(model, at.costs.table, lanes=device.type == "cuda"), device)
    cost_of = costs_by_kernels(kernels, model, there, at, weights, codes)
    yield timed(f"kernels, {samples} x {HORIZON_STEPS}", lambda: cost_of(controls), device, turns)
    wanted, size = cost_of(controls), f"{samples} x {HORIZON_STEPS}"
    coded, model = moved(at, codes, device), model.to(device)
    for compiled in (False, True):
        name = "pytorch_mppi, " + ("compiled" if compiled else "eager")
        with torch.device(device):
            roll = on_cpu.pytorch_mppi(model, coded, weights, controls, compiled=compiled)
            yield timed(f"{name}, {size}", roll, device, min(turns, 5))
            yield {
                "what": f"{name}: {on_cpu.agreement(roll(), wanted):.2f} of the costs are within 1 % of the kernels'"
            }
