"""Settings of a training, with defaults for logs of some minutes to some hours."""

import math
from dataclasses import astuple, dataclass, field
from typing import Any, Literal

from offpiste.core.errors import RunError

MOST_CODES = 256
"""Largest length of a code: longer ones would not compress."""


@dataclass(frozen=True)
class Weights:
    """Weights of the loss's components, whose units are the mean square errors of the kinematic bicycle."""

    position: float = 1.0
    yaw: float = 1.0
    vx: float = 1.0
    vy: float = 1.0
    yaw_rate: float = 1.0

    def in_order(self) -> tuple[float, ...]:
        """Return the weights in the order of `offpiste.training.losses.COMPONENTS`."""
        return astuple(self)


@dataclass(frozen=True)
class TrainConfig:
    """Settings of a training.

    Attributes:
        model: name of the model; an unknown name lists all models.
        codes: length of the code of the features under a wheel, in models with an encoder (the paper's n).
        pca: number of the dataset's features that models read, the first ones; 0: all.
        epochs: passes over the training windows for the model itself.
        bicycle_epochs: passes that fit the bicycle's constants before the network is added.
        refit_constants: train the bicycle's constants together with the network, as in the paper; otherwise they stay
            as fitted before.
        actuator_epochs: passes that fit the actuator models before they are frozen.
        batch: windows per step; use more on a GPU (docs/gpu.md).
        stride: rows between the windows of one epoch; the phase changes from epoch to epoch, so all rows are used.
        learning_rate: learning rate of Adam for networks.
        constants_learning_rate: learning rate of Adam for physical constants.
        gradient_clip: largest norm of a gradient.
        start: estimate of the state that predictions start from.
        min_speed: smallest speed at the start of a window [m/s]; 0: standstills as well; None: as in the dataset.
        loss: name of the loss; an unknown name lists all losses.
        weights: weights of the loss's components.
        seed: seed of the initial weights and the order of the windows.
        device: where to train: "cpu", "cuda", ...
    """

    model: str = "b"
    codes: int = 4
    pca: int = 0
    epochs: int = 30
    bicycle_epochs: int = 30
    refit_constants: bool = False
    actuator_epochs: int = 8
    batch: int = 128
    stride: int = 5
    learning_rate: float = 1e-3
    constants_learning_rate: float = 2e-2
    gradient_clip: float = 1.0
    start: Literal["causal", "smoothed"] = "causal"
    min_speed: float | None = None
    loss: str = "squared"
    weights: Weights = field(default_factory=Weights)
    seed: int = 0
    device: str = "cpu"


def refuse_impossible(config: TrainConfig) -> None:
    """Raise `RunError` with the name and limit of a setting that is out of range."""
    at_least_one = ("epochs", "bicycle_epochs", "actuator_epochs", "batch", "stride")
    positive = ("learning_rate", "constants_learning_rate", "gradient_clip")
    for name, good, allowed in (
        ("codes", 1 <= config.codes <= MOST_CODES, f"a number from 1 to {MOST_CODES}; the paper takes 1 to 16"),
        ("pca", config.pca >= 0, "0 or more"),
        ("seed", 0 <= config.seed < 1 << 63, "0 or more, below 2^63"),
        *((name, getattr(config, name) >= 1, "1 or more") for name in at_least_one),
        *((name, 0 < getattr(config, name) < math.inf, "a number above 0") for name in positive),
        ("min_speed", config.min_speed is None or 0 <= config.min_speed < math.inf, "a speed of 0 or more [m/s]"),
    ):
        if not good:
            raise RunError(f"invalid --{name.replace('_', '-')} {getattr(config, name):g}", how=f"give {allowed}")
    weights = config.weights.in_order()
    if not (all(0 <= weight < math.inf for weight in weights) and any(weights)):
        raise RunError(f"invalid loss weights {weights}", how="give numbers of 0 or more, and one above 0")


def other_settings(before: dict[str, Any], now: dict[str, Any]) -> str:
    """Describe how the settings of two runs differ; "" if they do not."""
    for key, new in now.items():
        then = before.get(key)
        if then != new and isinstance(then, dict):
            other = [name for name in {**then, **new} if then.get(name) != new.get(name)]
            if other:  # else one lacks a setting that the other has as None
                return ", ".join(f"{name} {then.get(name)} then, {new.get(name)} now" for name in other)
        elif then != new:
            return key
    return ""
