"""Loss of validation windows read on the map at predicted places: what epochs are chosen by, as it decides."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from offpiste.core.state import Trajectory
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import Dynamics
from offpiste.dynamics.kernels.map_rollout import predict_on
from offpiste.mapping.terrain_sampler import CellStack, MapTerrain
from offpiste.training.distributed import Group
from offpiste.training.terrain_sources import with_past_on

WINDOWS: Final = 300
"""Most windows that an epoch is chosen by."""

CORRIDOR: Final = 10.0
"""Cells of a snapshot within this distance of the recorded path are kept in memory [m].

Predictions that stray further find unknown ground. A window takes some 2 MB with 40 features.
"""

EVERY: Final = 10
"""Rows between the points of the path that the corridor is laid around."""

WindowLoss = Callable[[Trajectory, Batch], Float[Tensor, " B"]]
"""Loss of each window, from what is predicted for it."""


@dataclass(frozen=True)
class MapLoss:
    """Mean loss over validation windows with a snapshot, each read on its own at predicted places.

    Maps are read from disk once, when the first epoch asks; features are encoded as wheels come over them.

    Attributes:
        windows: of validation; on the CPU its kernels read maps, and a GPU would launch step after step.
        index: of the windows that are rolled out.
        group: the processes that share them out.
    """

    windows: Windows
    index: Int[np.ndarray, " n"]
    group: Group

    @torch.no_grad()
    def of(self, dynamics: Dynamics, loss: WindowLoss) -> float:
        """The mean loss of a model, computed where the windows lie."""
        trained, here = next(dynamics.parameters()).device, self.windows.device
        total = torch.zeros((), dtype=torch.float64, device=here)
        if len(self._mine):
            dynamics = dynamics if trained == here else deepcopy(dynamics).to(here)
            batch, maps = self._kept
            number = torch.arange(len(self._mine), device=self.windows.device)
            places = self.windows.places(self._mine)
            source = MapTerrain(maps, number, places, self.windows.wheels, dynamics.encoder)
            batch = with_past_on(source, batch)
            start = dynamics.start(batch.history, batch.state, batch.actuators)
            total += loss(predict_on(dynamics, start, batch.control, source), batch).double().sum()
        return float(self.group.sum(total.to(trained))) / len(self.index)

    @cached_property
    def _mine(self) -> Int[np.ndarray, " m"]:
        return self.index[self.group.share(len(self.index))]

    @cached_property
    def _kept(self) -> tuple[Batch, CellStack]:
        batch = replace(self.windows.gather(self._mine), ground=None)
        path = torch.cat((batch.state[:, None, :2], batch.target[:, EVERY - 1 :: EVERY, :2]), dim=1)
        places = path.double() + self.windows.places(self._mine)[:, None]
        return batch, self.windows.maps.near(self._mine, places.cpu().numpy(), CORRIDOR)


def map_loss(windows: Windows, group: Group, *, most: int = WINDOWS) -> MapLoss | None:
    """The loss on windows with a snapshot, `most` of them, evenly spread; None where there is no snapshot.

    Args:
        windows: all of a part; on a GPU they are made again on the CPU.
    """
    snapped = np.flatnonzero(windows.maps.snapped)
    if not len(snapped):
        return None
    if windows.device.type != "cpu":
        windows = Windows(windows.dataset, windows.part, start=windows.start, horizon=windows.horizon)
    chosen = np.unique(np.linspace(0, len(snapped) - 1, min(most, len(snapped))).round().astype(int))
    return MapLoss(windows, snapped[chosen], group)
