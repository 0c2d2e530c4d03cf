"""A plan's rollouts with map and cost: fused, eager, pytorch_mppi, and pytorch_mppi compiled, side by side in one run.

`python benchmarks/plan.py [--threads 2] [--samples 256 1024 4096] [--steps 250]`: medians in ms over 5 s. All read the
same map (600 x 600 cells of 0.2 m, waves), with the same dynamics and the same cost. pytorch_mppi calls dynamics and
cost step by step, so its cost is `costs.terms_after` of one step. Nothing is sampled in these times; the last line of
each model is a whole plan: noise, limits, rollouts, weights.
"""

import argparse
import statistics
import time
import warnings
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from offpiste.conventions import CONTROL, DT, HORIZON_STEPS
from offpiste.dynamics import Hybrid, Vehicle, as_callable
from offpiste.dynamics.encoder import Compressor
from offpiste.mapping.layers import TerrainLayers
from offpiste.mapping.lookup import MapTerrain, stack_maps
from offpiste.planning.costs import Situation, Weights, terms_after
from offpiste.planning.course import Course, Hazards, cost_map
from offpiste.planning.fused import encode_map, fused_costs
from offpiste.planning.mppi import PEDALS_AND_WHEEL, Settings, improve, sample
from offpiste.planning.rollouts import driving_costs
from offpiste.trajectory import Carry

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


def codes_first(at: Situation, codes: tuple[Tensor, Tensor]) -> Situation:
    """The situation with a map of codes instead of features, for planners that read one cell at a time."""
    cells = codes[0][None]
    return Situation(
        type(at.ground)(at.ground.resolution, at.ground.origin, at.ground.slope, cells),
        at.costs, at.wheels, at.offset, at.state, at.control,
    )  # fmt: skip


def stepwise(model: Hybrid, at: Situation, weights: Weights, samples: int) -> tuple[Callable, Callable]:
    """Dynamics and running cost for pytorch_mppi; lateral speed and control before a step travel with the state."""
    zeros, offset = torch.zeros(samples, dtype=torch.long), at.offset.expand(samples, 2)
    encode = (lambda features, valid: features) if model.codes else None
    step = as_callable(model, MapTerrain(at.ground, zeros, offset, at.wheels, encode))

    def dynamics(state: Tensor, control: Tensor) -> Tensor:
        return torch.cat((step(state[:, :-7], control), state[:, 4:5], state[:, -3:], control), dim=1)

    def cost(state: Tensor, control: Tensor) -> Tensor:
        terms = terms_after(state[:, :6], state[:, -7], control, state[:, -6:-3], at, weights)
        return DT * torch.stack(terms).sum(dim=0)

    return dynamics, cost


def start(model: Hybrid, at: Situation) -> Carry:
    """At rest within, at speed without."""
    units = torch.zeros(1, model.compensator.hidden + model.actuators.hidden)
    return Carry(at.state[None], torch.full((1, 4), torch.nan), units, units)


def pytorch_mppi(model: Hybrid, at: Situation, weights: Weights, controls: Tensor, *, compiled: bool) -> Callable:
    """Its rollout of the same control sequences."""
    from pytorch_mppi import MPPI

    dynamics, cost = stepwise(model, at, weights, len(controls))
    first = torch.cat((start(model, at).pack()[0].nan_to_num(), at.state[4:5], at.control, at.control))
    planner = MPPI(
        dynamics, cost, len(first), torch.eye(3), num_samples=len(controls), horizon=controls.shape[1],
        U_init=torch.zeros(controls.shape[1:]),
    )  # fmt: skip
    planner.state = first
    if compiled:
        planner.compile()
    return lambda: planner._compute_rollout_costs(controls)[0]


def timed(run: Callable[[], Tensor], seconds: float = 5.0) -> tuple[float, Tensor]:
    """Median time [ms] over some seconds, after a first call that may compile, and the costs."""
    costs, times, began = run(), [], time.perf_counter()
    while not times or (time.perf_counter() - began < seconds and len(times) < 50):
        before = time.perf_counter()
        run()
        times.append(1e3 * (time.perf_counter() - before))
    return statistics.median(times), costs


def agreement(costs: Tensor, reference: Tensor) -> float:
    """Share of samples whose costs agree to 1 %: rounding decides at edges of cells."""
    return ((costs - reference).abs() <= 0.01 * reference.abs()).float().mean().item()


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--samples", type=int, nargs="+", default=[256, 1024, 4096])
    parser.add_argument("--steps", type=int, nargs="+", default=[HORIZON_STEPS])
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--skip", nargs="*", default=[])
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    torch.set_num_threads(options.threads)
    torch.set_grad_enabled(False)
    torch.manual_seed(0)
    layers, weights = ground(), Weights()
    at = Situation(
        stack_maps([layers.terrain_map()]),
        cost_map(layers, Course(np.array([[-50.0, 0], [50.0, 0]]), np.full(2, 6.0)), Hazards()),
        WHEELS, torch.zeros(2, dtype=torch.float64), torch.tensor([0.0, 0, 0, 6, 0, 0]), torch.zeros(3),
    )  # fmt: skip
    settings = Settings(PEDALS_AND_WHEEL, (0.3, 0.1, 0.3))
    print(f"{options.threads} threads; rollouts with map and cost [ms], share of costs within 1 % of eager")
    for name in ("b", "dc"):
        vehicle = Vehicle(1200.0, 2.1, 0.5, CONTROL, ())
        model = Hybrid(vehicle, encoder=Compressor(FEATURES) if name == "dc" else None).requires_grad_(False)
        torch.nn.init.normal_(model.compensator.output[-1].weight, std=0.05)
        encoding, codes = time.perf_counter(), encode_map(at.ground, model.encoder)
        print(f"{name}: encoding the map once takes {1e3 * (time.perf_counter() - encoding):.0f} ms")
        coded, carry = codes_first(at, codes), start(model, at)
        fused = fused_costs(model, carry, at, weights, codes)
        eager = driving_costs(model, carry, coded, weights, (lambda features, valid: features) if model.codes else None)
        for steps in options.steps:
            for samples in options.samples:
                draw = torch.Generator().manual_seed(0)
                controls = sample(torch.tensor([0.3, 0.0, 0.0]).repeat(steps, 1), settings, draw)
                controls = controls.repeat(4, 1, 1)[:samples].clamp(-1, 1)
                runs = {
                    "fused": lambda: fused(controls),  # noqa: B023
                    "eager": lambda: eager(controls),  # noqa: B023
                    "pytorch-mppi": pytorch_mppi(model, coded, weights, controls, compiled=False),
                    "compiled": pytorch_mppi(model, coded, weights, controls, compiled=True),
                }
                found = {key: timed(run, options.seconds) for key, run in runs.items() if key not in options.skip}
                base, reference = found["fused"][0], found.get("eager", found["fused"])[1]
                parts = (
                    f"{key} {ms:7.1f} (x{ms / base:4.1f}, {agreement(costs, reference):.2f})"
                    for key, (ms, costs) in found.items()
                )
                print(f"{name:2} K {samples:4} T {steps:3} | " + " | ".join(parts), flush=True)
        plan = torch.tensor([0.3, 0.0, 0.0]).repeat(HORIZON_STEPS, 1)
        draw = torch.Generator().manual_seed(0)
        whole, _ = timed(lambda: improve(plan, fused, settings, draw, previous=at.control).controls, options.seconds)  # noqa: B023
        print(f"{name:2} a whole plan, K 1024, T 250, fused: {whole:.1f} ms", flush=True)


if __name__ == "__main__":
    main()
