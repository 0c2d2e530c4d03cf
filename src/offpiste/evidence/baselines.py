"""Models without networks beside `b`: whether `b`, which others are compared with, is worth comparing with."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import torch

from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import Dynamics
from offpiste.evaluation.errors import Errors
from offpiste.evaluation.evaluated_models import EvaluatedModel, with_baselines
from offpiste.reproduction.gains import HINDSIGHT, MAP, Gain, errors_of, evaluation_index, gain
from offpiste.training.run import Run

ABOUT: Final = (
    "The same windows; parametric: the actuators and the bicycle inside b, without its network; kinematic: a bicycle "
    "at constant speed, which needs no training. Where parametric is not better than kinematic, or b worse than "
    "parametric, log, rig or training have a fault, and gains over b say little: steering delay and sign first."
)


def baseline_gains(
    dataset: Dataset, runs: Sequence[Run], *, stride: int, scale: torch.Tensor, kept: Path
) -> list[Gain]:
    """Gains of `b` over its own physics, and of these over `kinematic`, on the map where there is one.

    Args:
        runs: of `b`.
        stride: of the windows at recorded places [rows].
        scale: of the loss.
        kept: folder of the errors.
    """
    windows, first = Windows(dataset, "test"), runs[0]
    reading = MAP if windows.maps.any else HINDSIGHT
    index = evaluation_index(windows, reading, stride)

    def errors(name: str, run: Run, dynamics: Dynamics | None = None) -> Errors:
        one = replace(run, folder=Path(f"{name}-{run.seed}"), dynamics=dynamics or run.dynamics)
        return errors_of(one, windows, index, reading, scale=scale, kept=kept)

    mine = [errors("b", run) for run in runs]
    physics = [errors("parametric", run, alone) for run in runs if (alone := physics_of(run.dynamics)) is not None]
    beside = with_baselines([EvaluatedModel("b", first.dynamics, seed=first.seed)], dataset, windows.device)
    simple = [errors(each.name, first, each.dynamics) for each in beside if each.name == "kinematic"]
    gains = []
    if physics:
        gains.append(gain("", "b", mine, physics, reading, baseline="parametric"))
    if physics and simple:
        gains.append(gain("", "parametric", physics, simple, reading, baseline="kinematic"))
    return gains


def physics_of(dynamics: Dynamics) -> Dynamics | None:
    """The actuators and the bicycle of a model without its network; None of models that have none."""
    alone, parts = dynamics.physics(), dynamics.kernel_parts()
    inside = alone.kernel_parts() if alone is not None else None
    if alone is None or parts is None or inside is None:
        return None
    inside.bicycle.load_state_dict(parts.bicycle.state_dict())
    return alone.eval()
