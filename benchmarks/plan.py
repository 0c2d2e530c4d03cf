"""What a plan costs: rollouts with map and cost by four planners, side by side in one run, and everything around them.

`python benchmarks/plan.py [--threads 2] [--samples 256 1024 4096] [--seconds 20] [--skip compiled] [--plan-alone]`.
All read the same map (600 x 600 cells of 0.2 m, waves), with the same dynamics and the same cost. pytorch_mppi calls
dynamics and cost step by step, so its cost is `driving_cost.terms_after` of one step. Planners take turns, so that what
else the machine does meets all alike; a line has the median and the best time, the processor's time [ms], how many
times as long as the fused one (median over turns; in brackets by the processor's time), and the share of costs within
1 % of eager.

`--cycle RUN --pca FILE` drives a run for some seconds on the proving ground instead, and prints the stages of its run
time.
"""

import argparse
import statistics
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from offpiste.core.conventions import CONTROL, DT, HORIZON_STEPS
from offpiste.core.state import ModelState
from offpiste.dynamics import Hybrid, Vehicle, as_callable
from offpiste.dynamics.feature_encoder import Compressor
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.mapping.terrain_sampler import MapTerrain, as_codes, stack_maps
from offpiste.planning.caution import Caution
from offpiste.planning.controls import CONTROL_LIMITS
from offpiste.planning.costs.layers import Hazards, cost_map
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.course import Course
from offpiste.planning.driving_cost import Situation, driving_costs, terms_after
from offpiste.planning.kernel import encode_map, fused_costs
from offpiste.planning.mppi import Settings, improve, limited, sample, weigh
from offpiste.uncertainty.spread import Spread, inputs_of

Planned = Callable[[Tensor, Tensor], Tensor]
"""Next states, or costs, of states and controls."""

FEATURES = 40
WHEELS = torch.tensor([[1.1, 0.8], [1.1, -0.8], [-1.1, 0.8], [-1.1, -0.8]])


def ground(cells: int = 600, resolution: float = 0.2) -> TerrainLayers:
    """Waves, 5 % of the cells unknown, features on 60 % of the rest."""
    draw = np.random.default_rng(0)
    at = resolution * (np.arange(cells) - cells // 2)
    x, y = np.meshgrid(at, at)
    normal = np.stack((-0.15 * np.cos(x / 5), -0.1 * np.sin(y / 4), np.ones_like(x)), -1).astype(np.float32)
    known = draw.random((cells, cells)) > 0.05
    normal[~known] = np.nan
    valid = draw.random((cells, cells)) > 0.4
    features = draw.normal(size=(cells, cells, FEATURES)).astype(np.float32)
    features[~valid] = np.nan
    nothing = np.zeros((cells, cells), np.float32)
    rough = (0.1 * draw.random((cells, cells))).astype(np.float32)
    return TerrainLayers(
        np.full(2, at[0]), resolution, nothing.astype(float), normal, nothing + 0.2, rough, nothing, features, nothing,
        known, known, valid,
    )  # fmt: skip


def stepwise(model: Hybrid, at: Situation, weights: CostWeights, samples: int) -> tuple[Planned, Planned]:
    """Dynamics and running cost for pytorch_mppi; velocity and control before a step travel with the state."""
    zeros, offset = torch.zeros(samples, dtype=torch.long, device=at.state.device), at.offset.expand(samples, 2)
    encode = as_codes(model.encoder.missing()) if model.encoder is not None else None
    callable_step = as_callable(model, MapTerrain(at.ground, zeros, offset, at.wheels, encode))

    def dynamics(state: Tensor, control: Tensor) -> Tensor:
        return torch.cat((callable_step(state[:, :-8], control, 0), state[:, 3:5], state[:, -3:], control), dim=1)

    def cost(state: Tensor, control: Tensor) -> Tensor:
        terms = terms_after(state[:, :6], state[:, -8:-6], control, state[:, -6:-3], at, weights)
        return DT * torch.stack(tuple(terms.values())).sum(dim=0)

    return dynamics, cost


def start(model: Hybrid, at: Situation) -> ModelState:
    """At rest within, at speed without."""
    units = torch.zeros(1, model.recurrent_size)
    return ModelState(at.state[None], torch.full((1, 4), torch.nan), units)


def pytorch_mppi(
    model: Hybrid, at: Situation, weights: CostWeights, controls: Tensor, *, compiled: bool
) -> Callable[[], Tensor]:
    """Its rollout of the same control sequences."""
    from pytorch_mppi import MPPI

    dynamics, cost = stepwise(model, at, weights, len(controls))
    first = torch.cat((start(model, at).pack()[0].nan_to_num(), at.state[3:5], at.control, at.control))
    planner = MPPI(
        dynamics, cost, len(first), torch.eye(3), num_samples=len(controls), horizon=controls.shape[1],
        U_init=torch.zeros(controls.shape[1:]), device=at.state.device,
    )  # fmt: skip
    planner.state = first
    if compiled:
        planner.compile()
    return lambda: planner._compute_rollout_costs(controls)[0]


class Taken(NamedTuple):
    """Times of one thing, turn after turn [ms], and what came out."""

    wall: list[float]
    processor: list[float]
    found: Tensor

    def __str__(self) -> str:
        wall = f"{statistics.median(self.wall):7.1f} (best {min(self.wall):6.1f}"
        return f"{wall}, processor {statistics.median(self.processor):6.1f}) ms"


def in_turns(runs: dict[str, Callable[[], Tensor]], seconds: float) -> dict[str, Taken]:
    """Times of several things that take turns for some seconds, three at least, after a first one that may compile."""
    taken = {name: Taken([], [], run()) for name, run in runs.items()}
    began, turns = time.perf_counter(), 0
    while turns < 3 or (time.perf_counter() - began < seconds and turns < 100):
        turns += 1
        for name, run in runs.items():
            wall, processor = time.perf_counter(), time.process_time()
            run()
            taken[name].processor.append(1e3 * (time.process_time() - processor))
            taken[name].wall.append(1e3 * (time.perf_counter() - wall))
    return taken


def times(taken: Taken, base: Taken) -> str:
    """How many times as long as another that it took turns with."""
    wall, processor = (
        statistics.median(a / b for a, b in zip(mine, other, strict=True))
        for mine, other in ((taken.wall, base.wall), (taken.processor, base.processor))
    )
    return f"x{wall:5.1f} ({processor:5.1f})"


def agreement(costs: Tensor, reference: Tensor) -> float:
    """Share of samples whose costs agree to 1 %: rounding decides at edges of cells."""
    return ((costs - reference).abs() <= 0.01 * reference.abs()).float().mean().item()


def compare(model: Hybrid, at: Situation, controls: Tensor, options: argparse.Namespace) -> None:
    """Print what the same rollouts cost each planner."""
    weights, codes = CostWeights(), encode_map(at.ground, model.encoder)
    # Codes instead of features, for planners that read one cell at a time.
    coded, model_state = replace(at, ground=replace(at.ground, features=codes[0][None])), start(model, at)
    fused = fused_costs(model, model_state, at, weights, codes)
    eager = driving_costs(model, model_state, coded, weights, as_codes(codes[1]) if model.codes else None)
    makers: dict[str, Callable[[], Callable[[], Tensor]]] = {
        "fused": lambda: lambda: fused(controls),
        "eager": lambda: lambda: eager(controls),
        "pytorch-mppi": lambda: pytorch_mppi(model, coded, weights, controls, compiled=False),
        "compiled": lambda: pytorch_mppi(model, coded, weights, controls, compiled=True),
    }
    taken = in_turns({name: make() for name, make in makers.items() if name not in options.skip}, options.seconds)
    reference = taken.get("eager", taken["fused"]).found
    for name, one in taken.items():
        same = agreement(one.found, reference)
        print(f"  {name:12} {one}  {times(one, taken['fused'])}  {same:.2f}", flush=True)


def whole_plan(models: dict[str, Hybrid], at: Situation, plan: Tensor, settings: Settings, seconds: float) -> None:
    """Print what a plan of 1024 x 250 is made of."""
    draw = torch.Generator().manual_seed(0)
    wanted = sample(plan, settings, draw)
    controls = limited(wanted, settings, at.control)
    runs: dict[str, Callable[[], Tensor]] = {
        "sampling": lambda: sample(plan, settings, draw),
        "limits": lambda: limited(wanted, settings, at.control),
        "weights, mean": lambda: torch.einsum("k,ktu->tu", weigh(controls[:, 0, 0], 1.0), controls),
    }
    for name, model in models.items():
        codes = encode_map(at.ground, model.encoder)
        if model.encoder is not None:
            runs[f"encoding, {name}"] = lambda model=model: encode_map(at.ground, model.encoder)[0]
        cost_of = fused_costs(model, start(model, at), at, CostWeights(), codes)
        runs[f"rollouts, {name}"] = lambda cost_of=cost_of: cost_of(controls)
        unsure = replace(at, caution=Caution(Spread(inputs_of(model.vehicle, model.codes)), 1.0))
        cautious = fused_costs(model, start(model, at), unsure, CostWeights(), codes)
        runs[f"rollouts, {name}, with spread"] = lambda cost_of=cautious: cost_of(controls)

        def whole(model: Hybrid = model, codes: tuple[Tensor, Tensor] = codes) -> Tensor:
            cost_of = fused_costs(model, start(model, at), at, CostWeights(), codes)
            return improve(plan, cost_of, settings, draw, previous=at.control).controls

        runs[f"whole, {name}"] = whole
    taken = in_turns(runs, seconds)
    for name, one in taken.items():
        print(f"  {name:24} {one}", flush=True)
    for name in models:
        with_spread = times(taken[f"rollouts, {name}, with spread"], taken[f"rollouts, {name}"])
        print(f"  {name}, with spread to without: rollouts {with_spread}")
    if "dc" in models:
        print(f"  dc to b: rollouts {times(taken['rollouts, dc'], taken['rollouts, b'])}")


def cycle(run: Path, pca: Path | None, seconds: float) -> None:
    """Drive a course and print the stages of the run time; the simulator's own sensors are listed too."""
    from offpiste.closed_loop.drive_course import CourseDriveSettings, drive_course
    from offpiste.runtime.planner import load_planner

    with TemporaryDirectory() as folder:
        driven = drive_course(load_planner(run, pca), CourseDriveSettings(seconds=seconds), Path(folder) / "drive")
    print("stage of the run time: how often, median, 95th percentile [ms]")
    for name, stage in driven.result["stages"].items():
        print(f"  {name:18} {stage['count']:5} {stage['median_ms']:8.1f} {stage['p95_ms']:8.1f}")


@torch.no_grad()
def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--samples", type=int, nargs="*", default=[256, 1024, 4096])
    parser.add_argument("--seconds", type=float, default=20.0, help="of turns, for each table")
    parser.add_argument("--skip", nargs="*", default=[], help="planners")
    parser.add_argument("--plan-alone", action="store_true", help="the parts of a whole plan, and nothing else")
    parser.add_argument("--cycle", type=Path, metavar="RUN")
    parser.add_argument("--pca", type=Path)
    parser.add_argument("--smoke", action="store_true", help="try everything once, with few samples")
    options = parser.parse_args(arguments)
    if options.smoke:
        options.samples, options.seconds, options.skip = [16], 0.0, ["compiled"]
    warnings.simplefilter("ignore")
    torch.set_num_threads(options.threads)
    if options.cycle:
        return cycle(options.cycle, options.pca, options.seconds)
    horizon = 5 if options.smoke else HORIZON_STEPS
    layers = ground(100 if options.smoke else 600)
    settings = Settings(CONTROL_LIMITS, (0.3, 0.1, 0.3), samples=16 if options.smoke else 1024)
    at = Situation(
        stack_maps([layers.terrain_map()]),
        cost_map(layers, Course(np.array([[-50.0, 0], [50.0, 0]]), np.full(2, 6.0)), Hazards()),
        WHEELS, torch.zeros(2, dtype=torch.float64), torch.tensor([0.0, 0, 0, 6, 0, 0]), torch.zeros(3),
    )  # fmt: skip
    models = {name: network(name) for name in ("b", "dc")}
    plan = torch.tensor([0.3, 0.0, 0.0]).repeat(horizon, 1)
    print(f"{options.threads} threads")
    print(f"a whole plan, K {settings.samples}, T {horizon}")
    whole_plan(models, at, plan, settings, options.seconds)
    if options.plan_alone:
        return None
    for name, model in models.items():
        for samples in options.samples:
            print(f"{name}, K {samples}, T {horizon}: rollouts with map and cost", flush=True)
            wanted = sample(plan, replace(settings, samples=samples), torch.Generator().manual_seed(0))
            compare(model, at, limited(wanted, settings, at.control), options)
    return None


def network(name: str) -> Hybrid:
    """`b` or `dc` with random weights."""
    torch.manual_seed(0)
    vehicle = Vehicle(1200.0, 2.1, 0.5, CONTROL, ())
    model = Hybrid(vehicle, encoder=Compressor(FEATURES) if name == "dc" else None).requires_grad_(False)
    last = model.compensator.output[-1]
    assert isinstance(last, torch.nn.Linear)
    torch.nn.init.normal_(last.weight, std=0.05)
    return model


if __name__ == "__main__":
    main()
