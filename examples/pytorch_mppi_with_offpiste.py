"""offpiste's dynamics inside pytorch_mppi: the model reads a map under each wheel and looks like any other callable.

`pip install pytorch-mppi`, then `python examples/pytorch_mppi_with_offpiste.py`. A new model stands in for a trained
one (`offpiste.training.checkpoint`); the vehicle starts at 4 m/s and is to follow the circle x^2 + y^2 = 20^2 at 5 m/s.
"""

import numpy as np
import torch
from pytorch_mppi import MPPI
from torch import Tensor

from offpiste.core.state import ModelState
from offpiste.dynamics import Hybrid, Vehicle, as_callable
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.mapping.terrain_sampler import MapTerrain, stack_maps

SAMPLES, STEPS, RADIUS, SPEED = 200, 75, 20.0, 5.0


def hilly_ground() -> TerrainMap:
    """Waves of 0.4 m, without visual features."""
    at = np.arange(-40, 40, 0.2)
    x, y = np.meshgrid(at, at)
    elevation = 0.4 * np.sin(x / 6) * np.cos(y / 5)
    return TerrainMap(np.array([-40.0, -40.0]), 0.2, elevation, np.zeros((*elevation.shape, 0), np.float32))


def cost(packed: Tensor, control: Tensor) -> Tensor:
    """Off the circle, not at the speed, both pedals at once [K]; a carry begins with x, y, yaw, vx."""
    x, y, _, vx = packed[:, :4].unbind(dim=1)
    return (torch.hypot(x, y) - RADIUS).square() + (vx - SPEED).square() + control[:, 0] * control[:, 1]


def drive(steps: int = 200, seed: int = 0) -> Tensor:
    """The states that the planner drives through [steps, 6]."""
    torch.manual_seed(seed)
    model = Hybrid(Vehicle(1200.0, 2.1, 0.5, ("throttle", "brake", "steer"), ())).requires_grad_(False)
    wheels = torch.tensor([[1.05, 0.8], [1.05, -0.8], [-1.05, 0.8], [-1.05, -0.8]])
    nowhere = torch.zeros(SAMPLES, 2, dtype=torch.float64)
    ground = MapTerrain(stack_maps([hilly_ground()]), torch.zeros(SAMPLES, dtype=torch.long), nowhere, wheels)
    step = as_callable(model, ground)

    state = torch.tensor([[RADIUS, 0.0, 1.57, 4.0, 0.0, 0.2]])
    recurrent = torch.zeros(1, model.recurrent_size)
    packed = ModelState(state, torch.full((1, 4), torch.nan), recurrent).pack()
    planner = MPPI(
        step,
        cost,
        nx=packed.shape[1],
        noise_sigma=torch.diag(torch.tensor([0.1, 0.02, 0.3])),
        num_samples=SAMPLES,
        horizon=STEPS,
        lambda_=0.3,
        u_min=torch.tensor([0.0, 0.0, -1.0]),
        u_max=torch.tensor([1.0, 1.0, 1.0]),
        U_init=torch.zeros(STEPS, 3),
    )
    one = as_callable(model, MapTerrain(ground.maps, ground.number[:1], ground.offset[:1], wheels))
    driven = []
    for t in range(steps):
        if t % 5 == 0:  # plan at 10 Hz
            for _ in range(5):
                planner.shift_nominal_trajectory()
            planner.command(packed[0], shift_nominal_trajectory=False)
        packed = one(packed, planner.U[t % 5][None], 0)
        driven.append(packed[0, :6])
    return torch.stack(driven)


if __name__ == "__main__":
    states = drive()
    off = (torch.hypot(states[:, 0], states[:, 1]) - RADIUS).abs()
    print(
        f"{0.02 * len(states):.0f} s: {off.mean():.2f} m off the circle on average, {states[-1, 3]:.1f} m/s at the end"
    )
