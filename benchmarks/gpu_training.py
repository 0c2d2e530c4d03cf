"""Stages of gpu.py: trainings, and the rollouts in them forward and back."""

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
from gpu_timing import Row, open_kernels, timed
from torch import Tensor
from torch.nn.functional import embedding

from offpiste.core.conventions import ACTUATORS, HORIZON_STEPS
from offpiste.core.state import ModelState, RecordedTerrain, Terrain
from offpiste.dataset.store import open_dataset
from offpiste.dynamics import rollout
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.header.gpu import check_kernels
from offpiste.dynamics.header.recorded import recorded_text, rollout_by_kernels
from offpiste.training.config import TrainConfig
from offpiste.training.prediction import codes_of_cells
from offpiste.training.run import best_epochs
from offpiste.training.train import train

SAME = 0.02
"""Largest relative difference of validation losses of a few epochs on two devices."""


def windows(dynamics: Dynamics, batch: int, device: torch.device) -> tuple[ModelState, Tensor, Terrain]:
    """Recorded ground for training."""
    draw = torch.Generator().manual_seed(0)
    state = torch.randn(batch, 6, generator=draw) + torch.tensor([0.0, 0, 0, 5, 0, 0])
    recurrent = 0.3 * torch.randn(batch, dynamics.recurrent_size, generator=draw)
    actuators = 0.1 * torch.rand(batch, len(ACTUATORS), generator=draw)
    shape = batch, HORIZON_STEPS
    controls = 0.5 * torch.rand(*shape, len(dynamics.vehicle.control_columns), generator=draw)
    latent = torch.randn(*shape, 4, dynamics.codes, generator=draw)
    up = torch.tensor([0.0, 0, 1]).expand(*shape, 4, 3)
    start = ModelState(*(part.to(device) for part in (state, actuators, recurrent)))
    known = torch.ones(*shape, 4, dtype=torch.bool)
    return start, controls.to(device), Terrain(up.to(device), known.to(device), latent.to(device))


def of_train(dynamics: Dynamics, device: torch.device, given: argparse.Namespace) -> Iterator[Row]:
    """Trainings on CPU and device: their validation losses must agree. With `--alone`, on the device only."""
    if given.dataset is None:
        raise SystemExit("the stage `train` needs --dataset, one with features")
    with TemporaryDirectory() as folder:
        epochs, dataset = given.epochs, open_dataset(given.dataset)
        model = "dc" if len(dataset.drives[0].rows.normal) > 1 else "df"
        for batch in given.batch:
            losses: list[float] = []
            for place in (str(device),) if given.alone else ("cpu", str(device)):
                config = TrainConfig(
                    model, epochs=epochs, bicycle_epochs=epochs, actuator_epochs=2, batch=batch, device=place
                )
                run, began = Path(folder) / f"run-{batch}-{len(losses)}", time.perf_counter()
                train(dataset, config, run)
                validation = best_epochs(run)["model"].validation_loss
                assert validation is not None
                losses.append(validation)
                took = time.perf_counter() - began
                yield {
                    "what": f"{epochs} epochs of {model} on {place}, batches of {batch}: {took:.1f} s, validation loss "
                    f"{losses[-1]:.5f}"
                }
            if not abs(losses[-1] - losses[0]) <= SAME * abs(losses[0]):
                raise SystemExit(f"validation losses differ: {losses[0]:.5f} on the CPU, {losses[-1]:.5f} on {device}")


def of_codes(batch: int, device: torch.device, turns: int) -> Iterator[Row]:
    """Codes under the wheels of recorded ground and their gradient by cell, by `codes_of_cells` and by torch."""
    draw, count = torch.Generator().manual_seed(0), 300 * batch
    codes = torch.randn(count, 4, generator=draw).to(device).requires_grad_()
    first = torch.randint(0, count - HORIZON_STEPS - 3, (batch, 1, 1), generator=draw)
    cells = (first + torch.arange(HORIZON_STEPS)[:, None] + torch.tensor([3, 2, 1, 0])).to(device)
    bar = torch.randn(*cells.shape, 4, generator=draw).to(device)
    ways: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
        "codes_of_cells": codes_of_cells,
        "torch's embedding": lambda rows, index: embedding(index, rows),
    }
    gradients = []
    for name, read in ways.items():
        yield timed(f"codes of {batch} windows by {name}", lambda read=read: read(codes.detach(), cells), device, turns)
        found = read(codes, cells)

        def back(found: Tensor = found) -> Tensor:
            return torch.autograd.grad(found, codes, bar, retain_graph=True)[0]

        yield timed("their gradient", back, device, turns)
        gradients.append((found.detach(), back()))
    torch.testing.assert_close(*gradients, atol=1e-4, rtol=1e-5)


def of_training(dynamics: Dynamics, device: torch.device, given: argparse.Namespace) -> Iterator[Row]:
    """Rollouts forward and back; the eager model on the same device for the smallest batch, unless the run is small."""
    small, turns = given.small, given.turns
    dynamics = dynamics.to(device)
    parts = dynamics.kernel_parts()
    for part in (parts and parts.compensator, dynamics.encoder):
        assert part is not None
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
        yield from of_codes(batch, device, turns)
        if batch == sizes[0] and not small:
            yield timed(f"the same eagerly, {batch} windows", eagerly, device, min(turns, 3))
