"""A training step of `dc`, against plain eager torch with the encoder on every row, side by side in one run.

`python benchmarks/train.py DATASET [--threads 2]` on a dataset with visual features, about five minutes on two quiet
cores. Two tables: the recurrent part alone (forward and backward) by kernels and by eager torch; and whole steps of the
optimiser by part. From them, what training of the paper's size would take here. All ways take turns, so that what else
the machine does touches them alike. Medians of wall clock and, in brackets, of processor time [ms].
"""

import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import tyro
from torch import Tensor, nn

from offpiste.core.state import ModelState, RecordedTerrain, Trajectory
from offpiste.dataset.feature_sets import per_trajectory
from offpiste.dataset.ground_tables import free_budget, ground_tables
from offpiste.dataset.store import open_dataset
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import Hybrid, Kinematic, rollout
from offpiste.dynamics.kernels.autograd import rollout_recorded
from offpiste.training.batches import draw_sets
from offpiste.training.config import TrainConfig
from offpiste.training.loop import keep_freed_memory
from offpiste.training.losses import loss_scale, summed_loss
from offpiste.training.prediction import encoded
from offpiste.training.run import build, vehicle_of
from offpiste.training.train import standardise

Mark = Callable[[str], None]
"""Says that the part of this name has just ended."""

Rollout = Callable[[ModelState, Batch], Trajectory]

PAPER = {"windows": 2_000_000, "evaluated": 250_000, "epochs": 30}
"""Section "Training" of the paper."""

PARTS = ("gather", "encode", "rollout", "loss", "backward", "optimiser")


@dataclass(frozen=True)
class Timed:
    """Median times of a part [ms]."""

    wall: float
    processor: float

    def __str__(self) -> str:
        return f"{self.wall:8.0f} ({self.processor:5.0f})"


def in_turn(readings: dict[str, Callable[[Mark], None]], repeats: int) -> dict[str, dict[str, Timed]]:
    """Times of every part of every way; a first turn is not counted."""
    found: dict[str, dict[str, list[tuple[float, float]]]] = {name: {} for name in readings}
    for turn in range(repeats + 1):
        for name, reading in readings.items():
            before = [time.perf_counter(), time.process_time()]

            def mark(part: str, name: str = name, before: list[float] = before, counted: bool = turn > 0) -> None:
                now = [time.perf_counter(), time.process_time()]
                if counted:
                    found[name].setdefault(part, []).append((now[0] - before[0], now[1] - before[1]))
                before[:] = now

            reading(mark)
    return {
        name: {
            part: Timed(*(1e3 * statistics.median(t) for t in zip(*times, strict=True))) for part, times in of.items()
        }
        for name, of in found.items()
    }


def total(parts: Iterable[Timed]) -> Timed:
    """Of all parts together."""
    listed = list(parts)
    return Timed(sum(t.wall for t in listed), sum(t.processor for t in listed))


def by_kernel(model: Hybrid) -> Rollout:
    """What training does on the CPU."""
    return lambda model_state, batch: rollout_recorded(model, model_state, batch.control, batch.terrain)


def by_eager(model: Hybrid) -> Rollout:
    """Plain torch."""
    return lambda model_state, batch: rollout(model, model_state, batch.control, RecordedTerrain(batch.terrain))


def recurrent(model: Hybrid, batch: Batch, roll: Rollout) -> Callable[[Mark], None]:
    """Forward and backward of the rollout alone."""

    def reading(mark: Mark) -> None:
        model.zero_grad()
        latent = batch.terrain.latent.detach().requires_grad_()
        read = replace(batch, terrain=replace(batch.terrain, latent=latent))
        with torch.no_grad():
            model_state = model.start(batch.history, batch.state, batch.actuators)
        model_state = replace(model_state, recurrent=model_state.recurrent.requires_grad_())
        mark("start")
        loss = roll(model_state, read).state[..., 3:].square().mean()
        mark("forward")
        loss.backward()  # type: ignore[no-untyped-call]
        mark("backward")

    return reading


@dataclass(frozen=True)
class Trainer:
    """Steps of the optimiser."""

    model: Hybrid
    windows: Windows
    scale: Tensor
    optimiser: torch.optim.Adam
    batch: int
    rng: np.random.Generator

    def step(self, mark: Mark, encode: Callable[[Hybrid, Batch], Batch], roll: Rollout) -> None:
        """One step, from the windows on disk to new weights."""
        index = self.rng.choice(len(self.windows), self.batch, replace=len(self.windows) < self.batch)
        batch = self.windows.gather(index, draw_sets(per_trajectory, self.windows, index, self.rng))
        mark("gather")
        batch = encode(self.model, batch)
        mark("encode")
        trajectory = roll(self.model.start(batch.history, batch.state, batch.actuators), batch)
        mark("rollout")
        loss = summed_loss(trajectory.state, batch.target, self.scale, torch.ones_like(self.scale)).mean()
        mark("loss")
        self.optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        mark("backward")
        nn.utils.clip_grad_norm_([p for g in self.optimiser.param_groups for p in g["params"]], 1.0)
        self.optimiser.step()
        mark("optimiser")

    def evaluate(self, mark: Mark) -> None:
        """Time of evaluating a batch of windows."""
        with torch.no_grad():
            index = self.rng.choice(len(self.windows), self.batch, replace=len(self.windows) < self.batch)
            batch = encoded(self.model, self.windows.gather(index))
            by_kernel(self.model)(self.model.start(batch.history, batch.state, batch.actuators), batch)
        mark("evaluate")


def encoded_by_row(model: Hybrid, batch: Batch) -> Batch:
    """Every wheel at every row is encoded, as without cells."""
    assert batch.ground is not None
    assert model.encoder is not None
    rows = torch.cat((batch.ground.past, batch.ground.ahead), dim=1)
    codes = model.encoder(batch.ground.features[rows.flatten()], batch.ground.valid[rows.flatten()])
    past, ahead = codes.unflatten(0, rows.shape).split((batch.ground.past.shape[1], batch.ground.ahead.shape[1]), dim=1)
    before = replace(batch.history.terrain, latent=past)
    return replace(batch, history=replace(batch.history, terrain=before), terrain=replace(batch.terrain, latent=ahead))


def make_trainer(dataset_path: Path, batch: int) -> Trainer:
    """A `dc` with weights that are not at rest, on the training windows of a dataset."""
    dataset, device = open_dataset(dataset_path), torch.device("cpu")
    windows = Windows(dataset, "train", ground=ground_tables(dataset, device, free_budget(device)))
    vehicle = vehicle_of(dataset)
    model = build("dc", vehicle, seed=0)
    assert isinstance(model, Hybrid)
    model.actuators.requires_grad_(False)
    standardise(model, windows)
    torch.manual_seed(0)
    last = model.compensator.output[-1]
    assert isinstance(last, nn.Linear)
    nn.init.normal_(last.weight, std=0.02)
    scale = loss_scale(Kinematic(vehicle), windows, TrainConfig(stride=max(50, len(windows) // 1000)))
    optimiser = torch.optim.Adam([p for p in model.parameters() if p.requires_grad], lr=1e-4)
    return Trainer(model, windows, scale, optimiser, batch, np.random.default_rng(0))


def recurrent_table(trainer: Trainer, repeats: int) -> str:
    """The rollout alone."""
    model = trainer.model
    with torch.no_grad():
        index = trainer.rng.choice(len(trainer.windows), trainer.batch)
        batch = encoded(model, trainer.windows.gather(index))
    readings = {"kernel": recurrent(model, batch, by_kernel(model)), "eager": recurrent(model, batch, by_eager(model))}
    found = in_turn(readings, repeats)
    best = total(found["kernel"][part] for part in ("forward", "backward"))
    lines = [f"{'recurrent part':16}{'forward':>16}{'backward':>16}   to the kernel: wall, processor"]
    for name, parts in found.items():
        both = total(parts[part] for part in ("forward", "backward"))
        ratios = f"{both.wall / best.wall:8.1f} {both.processor / best.processor:8.1f}"
        lines.append(f"{name:16}{parts['forward']!s:>16}{parts['backward']!s:>16}   {ratios}")
    return "\n".join(lines)


def step_table(trainer: Trainer, repeats: int) -> str:
    """Whole steps by part, and the paper's size from them."""
    kernel, eager = by_kernel(trainer.model), by_eager(trainer.model)
    found = in_turn(
        {
            "step": lambda mark: trainer.step(mark, encoded, kernel),
            "plain": lambda mark: trainer.step(mark, encoded_by_row, eager),
            "evaluate": trainer.evaluate,
        },
        repeats,
    )
    lines = [f"{'step of dc':16}{'here':>16}{'plain':>16}   ratio: wall, processor"]
    rows = {part: (found["step"][part], found["plain"][part]) for part in PARTS}
    rows["all"] = (total(found["step"].values()), total(found["plain"].values()))
    for part, (mine, plain) in rows.items():
        ratios = f"{plain.wall / mine.wall:8.1f} {plain.processor / mine.processor:8.1f}"
        lines.append(f"{part:16}{mine!s:>16}{plain!s:>16}   {ratios}")
    steps = PAPER["windows"] / trainer.batch * PAPER["epochs"]
    for reading, all_of in zip(("here", "plain"), rows["all"], strict=True):
        hours = f"{steps * all_of.wall / 3.6e6:.1f} h (processor {steps * all_of.processor / 3.6e6:.1f} h)"
        lines.append(f"paper size, {reading}: {hours} for {PAPER['epochs']} epochs of 2M windows")
    evaluate, batches = found["evaluate"]["evaluate"], PAPER["evaluated"] / trainer.batch
    minutes = f"{batches * evaluate.wall / 6e4:.1f} min (processor {batches * evaluate.processor / 6e4:.1f} min)"
    lines.append(f"evaluating 250k windows once: {minutes}")
    return "\n".join(lines)


def main(
    dataset: tyro.conf.Positional[Path],
    batch: int = 1024,
    threads: int = 2,
    repeats: int = 7,
    step_only: bool = False,
    smoke: bool = False,
) -> None:
    """Print both tables.

    Args:
        dataset: with visual features.
        batch: windows a step.
        threads: of torch and of the kernels.
        repeats: of everything; medians are printed.
        step_only: print what a step of `dc` takes and nothing else.
        smoke: one turn of a small batch, to try it.
    """
    if smoke:
        batch, repeats = 16, 1
    torch.set_num_threads(threads)
    keep_freed_memory()
    trainer = make_trainer(dataset, batch)
    if step_only:
        kernel = by_kernel(trainer.model)
        step = total(in_turn({"": lambda mark: trainer.step(mark, encoded, kernel)}, repeats)[""].values())
        print(f"step of dc: {step.wall:.0f} ms ({step.processor:.0f} ms)")
        return
    print(f"{batch} windows of {trainer.windows.horizon} steps, {threads} threads; median wall (processor) [ms]")
    print(recurrent_table(trainer, repeats), flush=True)
    print(step_table(trainer, repeats))


if __name__ == "__main__":
    tyro.cli(main)
