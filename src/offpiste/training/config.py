"""Settings of a training, with defaults that are right for a log of some minutes to some hours."""

import json
import math
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from offpiste.core.errors import RunError

MOST_CODES = 256
"""A longer code would not compress anything."""


@dataclass(frozen=True)
class Weights:
    """Weights of the loss's components, after each is divided by the kinematic bicycle's mean square error."""

    position: float = 1.0
    yaw: float = 1.0
    vx: float = 1.0
    vy: float = 1.0
    yaw_rate: float = 1.0

    def in_order(self) -> tuple[float, float, float, float, float]:
        """In the order of `offpiste.training.losses.COMPONENTS`."""
        return (self.position, self.yaw, self.vx, self.vy, self.yaw_rate)


@dataclass(frozen=True)
class TrainConfig:
    """Settings of a training.

    Attributes:
        model: name of a model; an unknown name lists those there are.
        codes: length of the code that models with an encoder make of the features under a wheel (the paper's n).
        pca: number of the dataset's features that models read, the first ones; 0: all.
        epochs: passes over the training windows for the model itself.
        bicycle_epochs: passes that fit the bicycle's constants before the network joins in.
        refit_constants: the bicycle's constants keep learning beside the network, as in the paper; otherwise they stay
            those that fit without it.
        actuator_epochs: passes that fit the actuator models before they are frozen.
        batch: windows in a step; more of them on a GPU, see docs/gpu.md.
        stride: rows between the windows of one epoch; the phase changes from epoch to epoch, so all rows are used.
        learning_rate: learning rate of Adam for networks.
        constants_learning_rate: learning rate of Adam for the constants of physics.
        gradient_clip: largest norm of a gradient.
        start: states that predictions start from, in training as in use.
        min_speed: windows start above it [m/s], 0: from standstills as well; None: as the dataset says.
        relative: 0: errors in metres count alike at any speed, as in the paper; 1: relative to the distance that is
            driven, so that slow windows matter.
        robust: 0: squared errors count, as in the paper; above: their root does in windows whose loss is well above the
            square of this (`offpiste.training.losses.robust`), so that the few worst windows do not rule.
        mirror: train on the mirror image of every second window, drawn anew each time; not the actuators.
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
    relative: float = 0.0
    robust: float = 0.0
    mirror: bool = False
    weights: Weights = field(default_factory=Weights)
    seed: int = 0
    device: str = "cpu"


def refuse_impossible(config: TrainConfig) -> None:
    """Raise unless every number of a training is one that it can work with.

    Raises:
        RunError: names the setting and its limit.
    """
    least = {"codes": 1, "pca": 0, "epochs": 1, "bicycle_epochs": 1, "actuator_epochs": 1, "batch": 1, "stride": 1}
    for name, limit in (least | {"seed": 0}).items():
        if getattr(config, name) < limit:
            _refuse(name, getattr(config, name), f"{limit} or more")
    if config.seed >= 1 << 63:
        _refuse("seed", config.seed, "a number below 2^63")
    if config.codes > MOST_CODES:
        _refuse("codes", config.codes, f"{MOST_CODES} or less; the paper takes 1 to 16")
    for name in ("learning_rate", "constants_learning_rate", "gradient_clip"):
        if not 0 < getattr(config, name) < math.inf:
            _refuse(name, getattr(config, name), "a number above 0")
    if config.min_speed is not None and not 0 <= config.min_speed < math.inf:
        _refuse("min_speed", config.min_speed, "a speed of 0 or more [m/s]")
    if not 0 <= config.relative <= 1:
        _refuse("relative", config.relative, "a number from 0 to 1")
    if not 0 <= config.robust < math.inf:
        _refuse("robust", config.robust, "a number of 0 or more; 0.5 is tried")
    weights = config.weights.in_order()
    if not (all(0 <= weight < math.inf for weight in weights) and any(weights)):
        raise RunError(f"weights of the loss are {weights}", how="give numbers of 0 or more, and one above 0")


def _refuse(name: str, value: int | float, allowed: str) -> None:
    option = "--" + name.replace("_", "-")
    raise RunError(f"{option} is {value:g}", how=f"give {allowed}")


def other_settings(before: dict[str, Any], now: dict[str, Any]) -> str:
    """What differs between the settings of two runs, in words."""
    if isinstance(before.get("train"), dict):  # of runs that are older than a setting
        before["train"] = {**json.loads(json.dumps(asdict(TrainConfig()))), **before["train"]}
    for key in now:
        then, new = before.get(key), now[key]
        if then != new and isinstance(then, dict):
            other = [name for name in new if then.get(name) != new[name]]
            if other:  # else an older run has a setting more
                return ", ".join(f"{name} {then.get(name)} then, {new[name]} now" for name in other)
        elif then != new:
            return key
    return ""
