"""Forward and backward of a training rollout: kernels against the eager model, in one run.

`python benchmarks/train_kernel.py [threads]`: medians in ms for `b` without actuators over 250 steps. On a busy machine
the eager model, with its many small operations, suffers more than the kernels.
"""

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from offpiste.conventions import CONTROL, HORIZON_STEPS
from offpiste.dynamics import Hybrid, Vehicle, rollout
from offpiste.dynamics.feature_encoder import Identity
from offpiste.dynamics.kernels.autograd import rollout_recorded
from offpiste.state import ModelState, RecordedTerrain, Terrain, Trajectory


def inputs(model: Hybrid, batch: int) -> tuple[ModelState, Tensor, Terrain]:
    """Windows that drive off at 1 to 9 m/s."""
    state = torch.zeros(batch, 6)
    state[:, 3] = 1 + 8 * torch.rand(batch)
    recurrent = torch.zeros(batch, model.compensator.hidden)
    controls = torch.rand(batch, HORIZON_STEPS, 3) * torch.tensor([0.6, 0.3, 0.4])
    normal = torch.tensor([0.0, 0.0, 1.0]).expand(batch, HORIZON_STEPS, 4, 3).contiguous()
    latent = torch.randn(batch, HORIZON_STEPS, 4, model.codes)
    terrain = replace(Terrain.of(normal), latent=latent)
    return ModelState(state, torch.full((batch, 4), torch.nan), recurrent, recurrent), controls, terrain


def timed(model: Hybrid, predict: Callable[[], Trajectory], repeats: int) -> tuple[float, float]:
    """Median times of the forward and of the backward pass [ms]."""
    forward, backward = [], []
    for _ in range(repeats + 1):
        model.zero_grad()
        began = time.perf_counter()
        loss = predict().state[..., 3:].square().mean()
        between = time.perf_counter()
        loss.backward()
        ended = time.perf_counter()
        forward.append(1e3 * (between - began))
        backward.append(1e3 * (ended - between))
    return statistics.median(forward[1:]), statistics.median(backward[1:])


def main() -> None:
    """Print the table."""
    torch.set_num_threads(int(sys.argv[1]) if len(sys.argv) > 1 else 2)
    print(f"{'codes':>5} {'batch':>5} | {'eager':>7} {'+back':>7} | {'kernel':>7} {'+back':>7} | ratio   [ms]")
    for codes in (0, 4):
        torch.manual_seed(0)
        vehicle = Vehicle(1200.0, 2.1, 0.5, CONTROL, ())
        model = Hybrid(vehicle, encoder=Identity(codes - 1) if codes else None)
        torch.nn.init.normal_(model.compensator.output[-1].weight, std=0.05)
        for batch in (128, 1024):
            model_state, controls, terrain = inputs(model, batch)
            terrain.latent.requires_grad_(codes > 0)
            eager = timed(model, lambda: rollout(model, model_state, controls, RecordedTerrain(terrain)), repeats=5)  # noqa: B023
            kernel = timed(model, lambda: rollout_recorded(model, model_state, controls, terrain), repeats=15)  # noqa: B023
            ratio = sum(eager) / sum(kernel)
            times = f"{eager[0]:7.0f} {eager[1]:7.0f} | {kernel[0]:7.1f} {kernel[1]:7.1f}"
            print(f"{codes:5} {batch:5} | {times} | {ratio:5.1f}")


if __name__ == "__main__":
    main()
