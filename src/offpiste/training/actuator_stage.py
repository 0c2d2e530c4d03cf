"""Fit of the actuators' delay models, alone and along the recorded speed."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import Vehicle
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.kernels.actuators import rollout_actuators, supports_actuators
from offpiste.dynamics.models import initial_actuators
from offpiste.training.config import TrainConfig
from offpiste.training.distributed import ALONE, Group
from offpiste.training.loop import BestEpoch, Record, Stage, run_stage

FITTED_STEPS: Final = 100
"""Steps of the loss, 2 s: actuators settle within a second or two."""

LARGEST_EPOCH: Final = 100_000
"""Approximate largest number of windows per epoch; of more windows, only some are used, evenly spread."""

LARGEST_BATCH: Final = 1024
"""Largest batch; a GPU's larger batches would leave too few steps."""

_SAMPLED: Final = 512
"""Number of windows that the actuators' variances are computed from."""


def actuators_to_fit(vehicle: Vehicle, config: TrainConfig, device: torch.device, group: Group) -> Actuators:
    """Return untrained actuators; on the CPU where its kernels support them, since a GPU would step eagerly."""
    lags = initial_actuators(vehicle, config.seed)
    alone = group.size == 1 and supports_actuators(lags, torch.device("cpu"), torch.float32)
    return lags if alone else lags.to(device)


def fit_actuators(
    actuators: Actuators,
    config: TrainConfig,
    windows: Windows,
    validation: Windows,
    folder: Path,
    record: Record,
    group: Group = ALONE,
) -> BestEpoch:
    """Fit the actuators' models in place (`run_stage`); the result does not depend on the model to train."""
    device = actuators.raw.device
    fitted, validated = (part.without_terrain(FITTED_STEPS, device) for part in (windows, validation))
    stride, batch = max(config.stride, -(-len(windows) // LARGEST_EPOCH)), min(config.batch, LARGEST_BATCH)
    config = replace(config, stride=stride, batch=batch, device=str(device))
    loss = actuator_loss(actuators, windows.without_terrain(device=device))
    stage = Stage("actuators", actuators, loss, config.actuator_epochs)
    return run_stage(stage, fitted, validated, config, folder, record, group)


def actuator_loss(actuators: Actuators, windows: Windows) -> Callable[[Batch], Float[Tensor, " B"]]:
    """Return the squared errors of the recorded actuators over `FITTED_STEPS`, each over its variance in training.

    They are rolled out along the recorded speed, by kernels if supported.
    """
    vehicle = actuators.vehicle
    present = [index for index, name in enumerate(vehicle.actuator_columns) if name in vehicle.actuators]
    spread = np.unique(np.linspace(0, len(windows) - 1, min(len(windows), _SAMPLED)).astype(int))
    variance = windows.gather(spread).target_actuators.flatten(0, 1).var(dim=0).clamp(min=1e-6)[present]

    def loss(batch: Batch) -> Tensor:
        speed = torch.cat((batch.state[:, None, 3], batch.target[:, :-1, 3]), dim=1)[:, :FITTED_STEPS]
        control, start = batch.control[:, :FITTED_STEPS], (batch.actuators, actuators.start(batch.history))
        if supports_actuators(actuators, control.device, control.dtype):
            predicted = rollout_actuators(actuators, control, speed, *start)
        else:
            predicted = actuators.rollout(*start, control, speed)
        recorded = batch.target_actuators[:, :FITTED_STEPS, present]
        error = (predicted[..., present] - recorded).square() / variance
        return error.mean(dim=1).sum(dim=-1)

    return loss
