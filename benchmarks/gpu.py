"""Parity and times on an NVIDIA GPU: rollouts with map and cost, whole plans, training steps. `gpu.sh` runs all of it.

`python benchmarks/gpu.py [--device cuda] [--out gpu.json] [--small]`. Without a GPU, `PYTHONPATH=tests python
benchmarks/gpu.py --device cpu --small` runs the same script on kernels that g++ compiled for this machine (from
tests/host_kernels.py), which checks the script, not the GPU: its times mean nothing.
"""

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import plan as on_cpu
import torch
from torch import Tensor

from offpiste.conventions import ACTUATORS, HORIZON_STEPS
from offpiste.cuda_kernels import Kernels, cuda_kernels
from offpiste.dynamics import rollout
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.header.gpu import check_kernels
from offpiste.dynamics.header.recorded import recorded_text, rollout_by_kernels
from offpiste.mapping.terrain_sampler import stack_maps
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
from offpiste.planning.mppi import Settings
from offpiste.planning.pedal import PEDAL_AND_WHEEL
from offpiste.state import ModelState, RecordedTerrain, Terrain
from offpiste.training.run import pretrained


def open_kernels(text: str, device: torch.device) -> Kernels:
    """Kernels on a GPU; on the CPU those that tests compile."""
    if device.type == "cuda":
        return cuda_kernels(text, device)
    from host_kernels import HostKernels

    return HostKernels(text, "-O2")


def milliseconds(run: Callable[[], Any], device: torch.device, turns: int) -> tuple[float, float]:
    """Median and best time of a function, the device's work included."""
    taken = []
    for turn in range(turns + 2):
        before = time.perf_counter()
        run()
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        if turn >= 2:
            taken.append(1e3 * (time.perf_counter() - before))
    return statistics.median(taken), min(taken)


def situation() -> Situation:
    """The map of benchmarks/plan.py."""
    layers = on_cpu.ground()
    course = Course(np.array([[-20.0, 0], [20, 3], [55, -4]]), np.full(3, 6.0))
    return Situation(
        stack_maps([layers.terrain_map()]), cost_map(layers, course, Hazards()), on_cpu.WHEELS,
        torch.zeros(2, dtype=torch.float64), torch.tensor([-10.0, 0.5, 0.2, 5, 0, 0]), torch.zeros(3),
    )  # fmt: skip


def windows(dynamics: Dynamics, batch: int, device: torch.device) -> tuple[ModelState, Tensor, Terrain]:
    """Recorded ground for training."""
    draw = torch.Generator().manual_seed(0)
    state = torch.randn(batch, 6, generator=draw) + torch.tensor([0.0, 0, 0, 5, 0, 0])
    hidden, cell = 0.3 * torch.randn(2, batch, dynamics.recurrent_size, generator=draw)
    actuators = 0.1 * torch.rand(batch, len(ACTUATORS), generator=draw)
    shape = batch, HORIZON_STEPS
    controls = 0.5 * torch.rand(*shape, len(dynamics.vehicle.control_columns), generator=draw)
    latent = torch.randn(*shape, 4, dynamics.codes, generator=draw)
    up = torch.tensor([0.0, 0, 1]).expand(*shape, 4, 3)
    start = ModelState(*(part.to(device) for part in (state, actuators, hidden, cell)))
    known = torch.ones(*shape, 4, dtype=torch.bool)
    return start, controls.to(device), Terrain(up.to(device), known.to(device), latent.to(device))


def of_plans(dynamics: Dynamics, device: torch.device, sizes: list[int], turns: int) -> dict[str, Any]:
    """Rollouts with map and cost, and whole plans."""
    at, weights = situation(), CostWeights(path=5.0)
    codes = encode_map(at.ground, dynamics.encoder)
    units = torch.zeros(1, dynamics.recurrent_size)
    start = ModelState(at.state[None], torch.tensor([[0.0, 0.0, 0.0, 1.0]]), units, units)
    there = ModelState(*(part.to(device) for part in vars(start).values()))
    kernels, rows = open_kernels(plan_text(dynamics, at.costs.table), device), {}
    for samples in sizes:
        settings = Settings(PEDAL_AND_WHEEL, (0.15, 0.15), samples=samples, temperature=3.0, rest=(0.4, 0.0))
        planner = DevicePlanner(kernels, dynamics, settings, torch.Generator(device).manual_seed(0))
        plan = torch.zeros(HORIZON_STEPS, 2)
        if samples == sizes[0]:
            check_planner(planner, plan, start, at, weights, codes)
        cost_of = costs_by_kernels(kernels, dynamics, there, at, weights, codes)
        controls = (0.3 * torch.rand(samples, HORIZON_STEPS, 3, generator=torch.Generator().manual_seed(1))).to(device)
        rows[f"rollouts with map and cost, {samples} x {HORIZON_STEPS}"] = milliseconds(
            lambda cost_of=cost_of, controls=controls: cost_of(controls), device, turns
        )
        rows[f"a whole plan of one iteration, {samples} x {HORIZON_STEPS}"] = milliseconds(
            lambda planner=planner, plan=plan: planner.improve(plan, start, at, weights, codes), device, turns
        )
    return rows


def of_training(dynamics: Dynamics, device: torch.device, sizes: list[int], turns: int) -> dict[str, Any]:
    """Rollouts forward and back; the eager model on the same device for the smallest batch."""
    dynamics = dynamics.to(device)
    for part in (dynamics.kernel_parts().compensator, dynamics.encoder):
        part.requires_grad_(True)
    kernels, rows = open_kernels(recorded_text(dynamics), device), {}
    check_kernels(kernels, dynamics, device)
    for batch in sizes:
        start, controls, terrain = windows(dynamics, batch, device)

        def by_kernels(start: ModelState = start, controls: Tensor = controls, terrain: Terrain = terrain) -> None:
            rollout_by_kernels(kernels, dynamics, start, controls, terrain).state.square().mean().backward()

        def eagerly(start: ModelState = start, controls: Tensor = controls, terrain: Terrain = terrain) -> None:
            rollout(dynamics, start, controls, RecordedTerrain(terrain)).state.square().mean().backward()

        rows[f"training, forward and back, {batch} windows"] = milliseconds(by_kernels, device, turns)
        if batch == sizes[0]:
            rows[f"the same eagerly, {batch} windows"] = milliseconds(eagerly, device, min(turns, 3))
    return rows


def main() -> None:
    """Check, time, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--out", type=Path, default=Path("gpu.json"))
    parser.add_argument("--small", action="store_true", help="few samples: for compute-sanitizer, or without a GPU")
    parser.add_argument("--turns", type=int, default=30)
    given = parser.parse_args()
    device, small = torch.device(given.device), given.small
    dynamics = pretrained("proving-ground/dc").dynamics.requires_grad_(False)
    turns = 2 if small else given.turns
    rows = of_plans(dynamics, device, [96] if small else [1024, 8192], turns)
    rows |= of_training(dynamics, device, [40] if small else [1024, 4096, 16384], turns)
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else platform.processor()
    print(f"{name}, torch {torch.__version__}: kernels agree with the CPU's and with the eager model")
    print("| what | median [ms] | best [ms] |\n|---|---|---|")
    for what, (median, best) in rows.items():
        print(f"| {what} | {median:.2f} | {best:.2f} |")
    given.out.write_text(json.dumps({"device": name, "torch": torch.__version__, "ms": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
