"""An epoch of the actuators' stage, from steps of it: `python benchmarks/train_actuators.py DATASET`.

Any dataset whose log has actuators will do; the epoch is that of 37 minutes of driving (stride 5, batch 128). Medians
of wall clock and, in brackets, of processor time. It runs on older commits too, to be compared with them in turns.
"""

import statistics
import time
from pathlib import Path

import numpy as np
import torch
import tyro

from offpiste.conventions import DT
from offpiste.dataset.store import open_dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics.models import initial_actuators
from offpiste.training.build import vehicle_of
from offpiste.training.config import TrainConfig
from offpiste.training.losses import FITTED_STEPS, actuator_loss

MINUTES = 37.0


def main(dataset: tyro.conf.Positional[Path], steps: int = 40, threads: int = 1) -> None:
    """Print the time of a step and of an epoch.

    Args:
        dataset: with actuators.
        steps: to take the median of.
        threads: of torch and of the kernels.
    """
    torch.set_num_threads(threads)
    opened, config = open_dataset(dataset), TrainConfig()
    windows = Windows(opened, "train")
    actuators = initial_actuators(vehicle_of(opened), config.seed)
    loss = actuator_loss(actuators, windows)
    read = windows.without_terrain(FITTED_STEPS) if hasattr(windows, "without_terrain") else windows
    optimiser, rng = torch.optim.Adam(actuators.parameters(), lr=1e-4), np.random.default_rng(0)
    taken = []
    for _ in range(steps + 2):
        index = rng.choice(len(windows), config.batch)
        began = time.perf_counter(), time.process_time()
        mean = loss(read.gather(index)).mean()
        optimiser.zero_grad()
        mean.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(actuators.parameters(), 1.0)
        optimiser.step()
        taken.append((time.perf_counter() - began[0], time.process_time() - began[1]))
    wall, processor = (statistics.median(column) for column in zip(*taken[2:], strict=True))
    batches = 60 * MINUTES / DT / config.stride / config.batch
    print(f"step of {config.batch} windows: {1e3 * wall:.1f} ms ({1e3 * processor:.1f} ms)")
    print(f"epoch of {MINUTES:g} min, {batches:.0f} steps: {batches * wall:.1f} s ({batches * processor:.1f} s)")


if __name__ == "__main__":
    tyro.cli(main)
