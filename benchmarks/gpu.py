"""Parity and times on an NVIDIA GPU; `gpu.sh` runs all stages, each in a process of its own (gpu_stages.py).

`python benchmarks/gpu.py [STAGE ...] [--device cuda] [--out FILE] [--small]`. Stages: `plans` (rollouts with map and
cost, whole plans, and the packing and copying in them), `training` (rollouts forward and back), `pytorch-mppi` (the
same rollouts by it, eager and compiled), `train` (trainings on the CPU and on the device, whose validation losses must
agree; with `--alone` on the device only). Rows are written as they come. Without a GPU,
`PYTHONPATH=tests python benchmarks/gpu.py plans --device cpu --small` runs a stage on kernels that g++ compiled for
this machine (from tests/host_kernels.py), which checks the script, not the GPU: its times mean nothing.
"""

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import plan as on_cpu
import torch
from torch import Tensor

from offpiste.conventions import ACTUATORS, HORIZON_STEPS
from offpiste.cuda_kernels import Kernels, cuda_kernels
from offpiste.dataset.store import open_dataset
from offpiste.dynamics import rollout
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.header.gpu import check_kernels
from offpiste.dynamics.header.recorded import recorded_text, rollout_by_kernels
from offpiste.errors import OffpisteError
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
from offpiste.planning.mppi import PEDALS_AND_WHEEL, Settings, limited, sample
from offpiste.planning.pedal import PEDAL_AND_WHEEL
from offpiste.planning.plan_graph import captured
from offpiste.state import ModelState, RecordedTerrain, Terrain
from offpiste.training.config import TrainConfig
from offpiste.training.run import kept_epochs, pretrained
from offpiste.training.train import train

Row = dict[str, Any]

SAME = 0.02
"""Largest relative difference of validation losses of a few epochs on two devices."""


def open_kernels(text: str, device: torch.device) -> Kernels:
    """Kernels on a GPU; on the CPU those that tests compile."""
    if device.type == "cuda":
        return cuda_kernels(text, device)
    from host_kernels import HostKernels

    return HostKernels(text, "-O2")


def timed(what: str, run: Callable[[], Any], device: torch.device, turns: int) -> Row:
    """Median and best time of a function [ms], the device's work included."""
    taken = []
    for turn in range(turns + 2):
        before = time.perf_counter()
        run()
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        if turn >= 2:
            taken.append(1e3 * (time.perf_counter() - before))
    return {"what": what, "median": statistics.median(taken), "best": min(taken)}


def by_events(what: str, run: Callable[[], Any], turns: int) -> Row:
    """Median and best time of a function between two events on the GPU [ms], without the way there and back."""
    taken = []
    for _ in range(turns + 2):
        began, ended = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        began.record()
        run()
        ended.record()
        torch.cuda.synchronize()
        taken.append(began.elapsed_time(ended))
    return {"what": what, "median": statistics.median(taken[2:]), "best": min(taken[2:])}


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


def of_train(dynamics: Dynamics, device: torch.device, given: argparse.Namespace) -> Iterator[Row]:
    """Trainings on CPU and device: their validation losses must agree. With `--alone`, on the device only."""
    from feature_datasets import dataset_with_features

    with TemporaryDirectory() as folder:
        path, epochs = given.dataset, given.epochs
        if path is None:
            path, epochs = Path(folder) / "dataset.zarr", 2
            dataset_with_features(path)
        dataset = open_dataset(path)
        model = "dc" if len(dataset.drives[0].rows.normal) > 1 else "df"
        for batch in given.batch:
            losses = []
            for place in (str(device),) if given.alone else ("cpu", str(device)):
                config = TrainConfig(
                    model, epochs=epochs, bicycle_epochs=epochs, actuator_epochs=2, batch=batch, device=place
                )
                run, began = Path(folder) / f"run-{batch}-{len(losses)}", time.perf_counter()
                train(dataset, config, run)
                losses.append(kept_epochs(run)["model"].validation_loss)
                took = time.perf_counter() - began
                yield {
                    "what": f"{epochs} epochs of {model} on {place}, batches of {batch}: {took:.1f} s, validation loss "
                    f"{losses[-1]:.5f}"
                }
            if not abs(losses[-1] - losses[0]) <= SAME * abs(losses[0]):
                raise SystemExit(f"validation losses differ: {losses[0]:.5f} on the CPU, {losses[-1]:.5f} on {device}")


def of_training(dynamics: Dynamics, device: torch.device, given: argparse.Namespace) -> Iterator[Row]:
    """Rollouts forward and back; the eager model on the same device for the smallest batch, unless the run is small."""
    small, turns = given.small, given.turns
    dynamics = dynamics.to(device)
    for part in (dynamics.kernel_parts().compensator, dynamics.encoder):
        part.requires_grad_(True)
    kernels, sizes = open_kernels(recorded_text(dynamics), device), [40] if small else [1024, 4096, 16384]
    if not small:
        check_kernels(kernels, dynamics, device)
        yield {"what": "states and gradients agree with the eager model's"}
    for batch in sizes:
        start, controls, terrain = windows(dynamics, batch, device)

        def by_kernels(start: ModelState = start, controls: Tensor = controls, terrain: Terrain = terrain) -> None:
            rollout_by_kernels(kernels, dynamics, start, controls, terrain).state.square().mean().backward()

        def eagerly(start: ModelState = start, controls: Tensor = controls, terrain: Terrain = terrain) -> None:
            rollout(dynamics, start, controls, RecordedTerrain(terrain)).state.square().mean().backward()

        yield timed(f"forward and back, {batch} windows", by_kernels, device, turns)
        if batch == sizes[0] and not small:
            yield timed(f"the same eagerly, {batch} windows", eagerly, device, min(turns, 3))


STAGES = {"plans": of_plans, "training": of_training, "pytorch-mppi": of_pytorch_mppi, "train": of_train}


def opened(name: str) -> torch.device:
    """A device; one line where there is none."""
    device = torch.device(name)
    if device.type == "cuda" and not torch.cuda.is_available():
        built = f"was built for CUDA {torch.version.cuda}" if torch.version.cuda else "was built without CUDA"
        raise SystemExit(f"no GPU '{name}': torch {torch.__version__} {built}, and sees none here")
    return device


def main() -> None:
    """Check, time, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stages", nargs="*", metavar="STAGE", help=f"of {', '.join(STAGES)}; none: names the device")
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--out", type=Path, default=Path("gpu.json"))
    parser.add_argument("--small", action="store_true", help="few samples, no graph: for memcheck, or without a GPU")
    parser.add_argument("--turns", type=int, default=30)
    parser.add_argument("--dataset", type=Path, help="of the stage `train`, with features; made-up drives otherwise")
    parser.add_argument("--epochs", type=int, default=10, help="of bicycle and model on that dataset")
    parser.add_argument("--batch", type=int, nargs="+", default=[128], help="windows a step of the stage `train`")
    parser.add_argument("--alone", action="store_true", help="train on the device only, not on the CPU as well")
    given = parser.parse_args()
    if given.small:
        given.turns = 2
    if unknown := set(given.stages) - set(STAGES):
        parser.error(f"no stage {', '.join(sorted(unknown))}")
    device = opened(given.device)
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else platform.processor()
    print(f"{name}, torch {torch.__version__}, CUDA {torch.version.cuda}", flush=True)
    rows: list[Row] = []
    for stage in given.stages:
        dynamics = pretrained("proving-ground/dc").dynamics.requires_grad_(False)
        for row in STAGES[stage](dynamics, device, given):
            rows.append(row)
            given.out.write_text(json.dumps(rows, indent=2) + "\n")
            print(row, flush=True)


if __name__ == "__main__":
    try:
        main()
    except OffpisteError as error:
        raise SystemExit(str(error)) from error
