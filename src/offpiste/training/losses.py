"""Losses of training: registered by name, their units and weights, and the validation loss on maps."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from offpiste.core.errors import RunError, TrainingError
from offpiste.core.registry import Registry
from offpiste.core.state import Trajectory, wrap_angle
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import Dynamics
from offpiste.dynamics.kernels.map_rollout import predict_on
from offpiste.mapping.terrain_sampler import CellStack, MapTerrain
from offpiste.training.config import TrainConfig
from offpiste.training.distributed import Group
from offpiste.training.prediction import in_parts, predict_batch, with_past_on

LARGEST_SCALE: Final = 1e30
"""Units and weights of the loss are less: float32 holds their product with an error."""

COMPONENTS: Final = ("position", "yaw", "vx", "vy", "yaw_rate")
"""Components of the loss [m, rad, m/s, m/s, rad/s]."""

SCALED: Final = 100_000
"""Approximate largest number of windows that the loss's units are computed from."""

BEND: Final = 0.5
"""Root of the loss above which `charbonnier` grows linearly with the error."""

MAP_WINDOWS: Final = 300
"""Largest number of windows that an epoch is chosen by on maps."""

CORRIDOR: Final = 10.0
"""Distance from the recorded path within which cells of a map are known and in memory [m], some 2 MB a window."""

EVERY: Final = 10
"""Rows between the points of the path around which the corridor is laid."""

Loss = Callable[[Float[Tensor, "B T 5"], Float[Tensor, " 5"]], Float[Tensor, " B"]]
"""Maps squared errors by window, step and component, and a weight for each component, to the loss of each window."""

LOSSES: Final[Registry[Loss]] = Registry("loss", error=RunError)
"""Losses by name (`train --loss NAME`)."""

WindowLoss = Callable[[Trajectory, Batch], Float[Tensor, " B"]]
"""Loss of each window, from its prediction."""


@LOSSES.register("squared")
def squared_loss(squared: Float[Tensor, "B T 5"], weights: Float[Tensor, " 5"]) -> Float[Tensor, " B"]:
    """Return the mean over steps and weighted sum over components, as in the paper."""
    return (squared.mean(dim=1) * weights).sum(dim=-1)


@LOSSES.register("charbonnier")
def charbonnier_loss(squared: Float[Tensor, "B T 5"], weights: Float[Tensor, " 5"]) -> Float[Tensor, " B"]:
    """Return the squared loss x with a bent tail: 2 d (sqrt(x + d²) - d) with d = `BEND` (Charbonnier et al. 1994).

    It equals x far below d² and grows as sqrt(x) far above, so that the few worst windows do not dominate.
    """
    return 2 * BEND * (torch.sqrt(squared_loss(squared, weights) + BEND**2) - BEND)


def squared_errors(predicted: Float[Tensor, "B T 6"], target: Float[Tensor, "B T 6"]) -> Float[Tensor, "B T 5"]:
    """Return squared errors by component (`COMPONENTS`): of the position vector, of the wrapped yaw."""
    difference = predicted - target
    position = difference[..., :2].square().sum(dim=-1)
    yaw = wrap_angle(difference[..., 2]).square()
    return torch.stack((position, yaw, *difference[..., 3:].square().unbind(-1)), dim=-1)


def summed_loss(
    predicted: Float[Tensor, "B T 6"],
    target: Float[Tensor, "B T 6"],
    scale: Float[Tensor, " 5"],
    weights: Float[Tensor, " 5"],
) -> Float[Tensor, " B"]:
    """Return the squared loss of each window, by which models are evaluated, in units of `loss_scale`."""
    return squared_loss(squared_errors(predicted, target), (weights / scale).to(target.device))


def loss_scale(reference: Dynamics, windows: Windows, config: TrainConfig) -> Float[Tensor, " 5"]:
    """Return the mean square error of the reference model on training windows by component: the units of the loss.

    Raises:
        TrainingError: an error is so large that no vehicle moved so.
    """
    if not reference.reads_terrain:
        windows = windows.without_terrain()
    errors = []
    stride, size = max(config.stride, -(-len(windows) // SCALED)), max(2048, config.batch)
    with torch.no_grad():
        for part in in_parts(windows.strided(stride), windows, None, size=size):
            batch = windows.gather(part)
            errors.append(squared_errors(predict_batch(reference, batch).state, batch.target))
    scale = torch.cat(errors).mean(dim=(0, 1)).clamp(min=1e-8)
    for name, value in zip(COMPONENTS, scale.tolist(), strict=True):
        if not value < LARGEST_SCALE:
            what = f"the mean square error of the reference model in {name} is {value:g}: the motion is impossible"
            raise TrainingError(what, where=windows.dataset.path, how="inspect the logs, and leave out damaged drives")
    return scale


@dataclass(frozen=True)
class MapLoss:
    """Mean loss over validation windows, each read on its own map at predicted places.

    Maps are read from disk once, on first use; features are encoded as wheels reach them.
    """

    windows: Windows  # validation windows, on the CPU, whose kernels read maps
    index: Int[np.ndarray, " n"]  # indices of the windows used
    group: Group  # processes that share the windows

    @torch.no_grad()
    def of(self, dynamics: Dynamics, loss: WindowLoss) -> float:
        """Return the mean loss of a model."""
        trained, here = next(dynamics.parameters()).device, self.windows.device
        total = torch.zeros((), dtype=torch.float64, device=here)
        if len(self._mine):
            dynamics = dynamics if trained == here else deepcopy(dynamics).to(here)
            batch, maps = self.kept
            number, places = torch.arange(len(self._mine), device=here), self.windows.places(self._mine)
            source = MapTerrain(maps, number, places, self.windows.wheels, dynamics.encoder)
            batch = with_past_on(source, batch)
            start = dynamics.start(batch.history, batch.state, batch.actuators)
            total += loss(predict_on(dynamics, start, batch.control, source), batch).double().sum()
        return float(self.group.sum(total.to(trained))) / len(self.index)

    @cached_property
    def _mine(self) -> Int[np.ndarray, " m"]:
        return self.index[self.group.share(len(self.index))]

    @cached_property
    def kept(self) -> tuple[Batch, CellStack]:
        """Windows of this process and their maps near the recorded path."""
        batch = replace(self.windows.gather(self._mine), ground=None)
        path = torch.cat((batch.state[:, None, :2], batch.target[:, EVERY - 1 :: EVERY, :2]), dim=1)
        places = path.double() + self.windows.places(self._mine)[:, None]
        return batch, self.windows.maps.near(self._mine, places.cpu().numpy(), CORRIDOR)


def map_loss(windows: Windows, group: Group) -> MapLoss | None:
    """Return the loss on evenly spread windows of a part with a map snapshot; None if there is no snapshot."""
    snapped = np.flatnonzero(windows.maps.snapped)
    if not len(snapped):
        return None
    if windows.device.type != "cpu":  # kernels that read maps run on the CPU
        windows = Windows(windows.dataset, windows.part, start=windows.start, horizon=windows.horizon)
    chosen = np.unique(np.linspace(0, len(snapped) - 1, min(MAP_WINDOWS, len(snapped))).round().astype(int))
    return MapLoss(windows, snapped[chosen], group)
