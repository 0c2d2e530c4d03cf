"""The bicycle's fitted constants, run by run, and the rear axle that a recording itself suggests."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import tyro
from jaxtyping import Float

from experiments.command import run
from offpiste.conventions import DT
from offpiste.dataset.store import open_dataset
from offpiste.dynamics.bicycle import BicycleConstants
from offpiste.errors import RunError
from offpiste.training.run import load_run

_BANDS = ((1.5, np.inf), (1.5, 3.0), (3.0, 5.0), (5.0, 8.0), (8.0, np.inf))
_LEAST_YAW_RATE = 0.05
"""Below it, the lateral velocity says little about where the rear axle is [rad/s]."""


@dataclass(frozen=True)
class Constants:
    """Print the bicycle's constants of trained runs as a table, forces per mass.

    With datasets, also the distance from the rear axle to the pose point: by least squares a of vy = a r + b r vx²,
    where tyres answer in proportion to slip, and of vy = a r, without slip.
    """

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Folders that `offpiste train` wrote."""
    dataset: Annotated[tuple[Path, ...], tyro.conf.arg(aliases=["-d"])] = ()
    """Datasets to estimate the rear axle's place from."""

    def run(self) -> str:
        """The tables as text.

        Raises:
            RunError: a run is missing, damaged or without a bicycle.
            DatasetError: not a dataset.
        """
        lines = constants_table([(folder.name, _fitted(folder)) for folder in self.runs])
        for path in self.dataset:
            for drive in open_dataset(path).drives:
                lines += ["", f"{drive.name}", "", *rear_axle_table(np.asarray(drive.rows.state, dtype=float))]
        return "\n".join(lines)


def _fitted(folder: Path) -> BicycleConstants:
    for module in load_run(folder).dynamics.modules():
        if isinstance(module, BicycleConstants):
            return module
    raise RunError("has no bicycle", where=folder, how="give runs of `parametric`, `b` or the models built on it")


def constants_table(fitted: Sequence[tuple[str, BicycleConstants]]) -> list[str]:
    """Markdown: what can be compared between vehicles, a row for each constant and a column for each run."""
    lines = [f"| | {' | '.join(name for name, _ in fitted)} |", "|" + "---|" * (len(fitted) + 1)]
    columns = [_comparable(constants) for _, constants in fitted]
    return lines + [f"| {name} | {' | '.join(f'{c[name]:.3g}' for c in columns)} |" for name in columns[0]]


def _comparable(constants: BicycleConstants) -> dict[str, float]:
    with torch.no_grad():
        c = constants()
    rear = c.rear_peak * c.rear_shape * c.rear_stiffness
    front = c.front_peak * c.front_shape * c.front_stiffness
    values = {
        "C_max [m/s]": c.min_slip_speed,
        "C_max over Euler's bound": c.min_slip_speed * c.mass / (DT * (rear + front)),
        "L_R [m]": c.rear_length,
        "L_F [m]": c.front_length,
        "D_R / m [m/s²]": c.rear_peak / c.mass,
        "D_F / m [m/s²]": c.front_peak / c.mass,
        "C_rd [1/s]": c.yaw_damping,
        "C_r / (C_L C_rd) [1/m]": c.yaw_gain / c.yaw_damping,
        "C_xd [1/m]": c.drag_x,
        "C_yd [1/m]": c.drag_y,
        "C_xg [m/s²]": c.gravity_x,
        "C_yg [m/s²]": c.gravity_y,
    }
    return {name: float(value) for name, value in values.items()}


def rear_axle_table(state: Float[np.ndarray, "n 6"]) -> list[str]:
    """Markdown: distance from the rear axle to the pose point [m] by speed, from all complete rows of a drive."""
    lines = ["| speed [m/s] | rows | with slip | without |", "|---|---|---|---|"]
    for low, high in _BANDS:
        a, alone, rows = rear_axle(state, low, high)
        band = f"{low:g} to {high:g}" if np.isfinite(high) else f"above {low:g}"
        lines.append(f"| {band} | {rows} | {a:.2f} | {alone:.2f} |")
    return lines


def rear_axle(state: Float[np.ndarray, "n 6"], low: float, high: float) -> tuple[float, float, int]:
    """Distance from the rear axle to the pose point [m], with the slip's term and without, and the rows it is from.

    At the rear axle the vehicle moves where it points, less the slip that its share of the lateral force r vx needs:
    vy = L_R r - r vx² / (stiffness per load), NaN where fewer than 50 rows turn.
    """
    vx, vy, yaw_rate = state[:, 3:].T
    chosen = np.isfinite(state).all(axis=1) & (vx > low) & (vx < high) & (np.abs(yaw_rate) > _LEAST_YAW_RATE)
    if chosen.sum() < 50:
        return np.nan, np.nan, int(chosen.sum())
    terms = np.stack([yaw_rate, yaw_rate * vx**2], axis=1)[chosen]
    a, _ = np.linalg.lstsq(terms, vy[chosen], rcond=None)[0]
    return float(a), float(terms[:, 0] @ vy[chosen] / (terms[:, 0] @ terms[:, 0])), int(chosen.sum())


if __name__ == "__main__":
    run(Constants)
