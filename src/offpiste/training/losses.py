"""Losses of training: errors along the whole horizon in units of the reference's errors, and the actuators' own."""

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import min_evaluation_speed
from offpiste.core.state import wrap_angle
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import Dynamics
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.kernels.actuators import rollout_actuators, supports_actuators
from offpiste.training.config import TrainConfig
from offpiste.training.prediction import in_parts, predict

COMPONENTS = ("position", "yaw", "vx", "vy", "yaw_rate")
"""[m, rad, m/s, m/s, rad/s]"""

SCALED = 100_000
"""Windows, or about as many, that the units are taken from: with more of them they lie further apart."""


def squared_errors(predicted: Float[Tensor, "B T 6"], target: Float[Tensor, "B T 6"]) -> Float[Tensor, "B T 5"]:
    """Squared errors by component: of position as a vector, of yaw wrapped."""
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
    """The loss of each window: mean over its steps, summed over the components.

    Args:
        scale: mean square error of the reference (`loss_scale`), in the components' units squared, on any device.
        weights: weight of each component (`offpiste.training.config.Weights.in_order`), beside it.
    """
    return (squared_errors(predicted, target).mean(dim=1) * (weights / scale).to(target.device)).sum(dim=-1)


def robust(loss: Float[Tensor, " B"], bend: float) -> Float[Tensor, " B"]:
    """Losses of windows as Charbonnier et al. (1994) take them: 2 d (sqrt(x + d²) - d), with the loss x and d `bend`.

    Far below d² it is x, far above it grows as the root of x does, thus as a distance and not as its square: what may
    happen one way or the other is predicted nearer to its median than to its mean. With d = 0 it is x everywhere.
    """
    return 2 * bend * (torch.sqrt(loss + bend**2) - bend) if bend else loss


def loss_scale(reference: Dynamics, windows: Windows, config: TrainConfig) -> Float[Tensor, " 5"]:
    """Mean square error of the reference on the training windows by component: the units of the loss."""
    if not reference.reads_terrain:
        windows = windows.without_terrain()
    errors = []
    stride, size = max(config.stride, -(-len(windows) // SCALED)), max(2048, config.batch)
    with torch.no_grad():
        for part in in_parts(windows.strided(stride), windows, None, size=size):
            batch = windows.gather(part)
            errors.append(squared_errors(predict(reference, batch).state, batch.target))
    return torch.cat(errors).mean(dim=(0, 1)).clamp(min=1e-8)


def speed_weights(windows: Windows, relative: float) -> Callable[[Batch], Float[Tensor, " B"]]:
    """Weights (speed + least)^(-2 relative) of windows, with a mean of 1 over all that train.

    Errors grow with the distance, so that slow windows hardly count without.

    Args:
        windows: that train.
        relative: 0: an error in metres counts as much at any speed, as in the paper; 1: relative to the distance that a
            window goes, but for `least`, the speed from which windows are evaluated (`min_evaluation_speed`).
    """
    least = min_evaluation_speed(windows.dataset.rig.vehicle.wheelbase)

    def weigh(state: Tensor) -> Tensor:
        return (torch.linalg.vector_norm(state[:, 3:5], dim=-1) + least) ** (-2 * relative)

    states = torch.as_tensor(windows.motion()["state_causal"][windows.rows])
    mean = float(weigh(states).double().mean())
    return lambda batch: weigh(batch.state) / mean


FITTED_STEPS = 100
"""Steps of the actuators' loss: they settle within a second or two, so it reaches 2 s ahead, not 5."""
_SAMPLED = 512
"""Windows by which actuators are scaled."""


def actuator_loss(actuators: Actuators, windows: Windows) -> Callable[[Batch], Float[Tensor, " B"]]:
    """Squared errors of the recorded actuators over `FITTED_STEPS`, each over its variance on training rows.

    The lags alone are rolled out, along the recorded speed: what the vehicle does is not yet predicted.
    """
    vehicle = actuators.vehicle
    present = [index for index, name in enumerate(vehicle.actuator_columns) if name in vehicle.actuators]
    variance = actuator_variance(windows)[present]

    def loss(batch: Batch) -> Tensor:
        predicted = roll_actuators(actuators, batch)[..., present]
        error = (predicted - batch.target_actuators[:, :FITTED_STEPS, present]).square() / variance
        return error.mean(dim=1).sum(dim=-1)

    return loss


def actuator_variance(windows: Windows) -> Float[Tensor, " A"]:
    """Variance of each recorded actuator, over windows from all of the drives."""
    spread = np.unique(np.linspace(0, len(windows) - 1, min(len(windows), _SAMPLED)).astype(int))
    return windows.gather(spread).target_actuators.flatten(0, 1).var(dim=0).clamp(min=1e-6)


def roll_actuators(actuators: Actuators, batch: Batch) -> Float[Tensor, "B S A"]:
    """Actuators at the first `FITTED_STEPS` rows after t, along the recorded speed; by kernels where they can."""
    speed = torch.cat((batch.state[:, None, 3], batch.target[:, :-1, 3]), dim=1)[:, :FITTED_STEPS]
    control = batch.control[:, :FITTED_STEPS]
    start = batch.actuators, *actuators.start(batch.history)
    if supports_actuators(actuators, control.device, control.dtype):
        return rollout_actuators(actuators, control, speed, *start)
    return actuators.rollout(*start, control, speed)
