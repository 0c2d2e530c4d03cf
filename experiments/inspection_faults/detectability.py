"""How far healthy logs differ in what an error would change: `python -m experiments.inspection_faults.detectability`.

Each drive is recorded twice, the second time as a vehicle of another size. What the checks measure in healthy
recordings (centre, delays and scales) scatters, and an error shifts it. So the scatter alone tells how many healthy
logs are warned by a limit that finds half, or nine tenths, of the errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from experiments.command import run
from experiments.inspection_faults.drives import TrueDrive, drive_of, scaled
from experiments.inspection_faults.recording import Case, recorded
from experiments.inspection_faults.study import Study
from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.response import curvature_per_unit, pedal_fits, steering_fits
from offpiste.logs.drive import drive_from_log

_CLEAR, _EFFECT = 0.7, 0.3
"""Correlations above which centre and scale of a steering, and delays, are clear."""


def _logarithms(*factors: float) -> tuple[float, ...]:
    return tuple(float(np.log(factor)) for factor in factors)


ERRORS: Final[dict[str, tuple[str, tuple[float, ...]]]] = {
    "steer: offset 0.02": ("steer: centre", (-0.02, 0.02)),
    "steer: offset 0.05": ("steer: centre", (-0.05, 0.05)),
    **{
        f"{name} late or early by {late} s": (f"{name}: delay", (-late, late))
        for name in ("steer", "brake", "throttle")
        for late in (0.1, 0.2)
    },
    "`max_steer`, or scale of steer, 0.75 or 1.33": ("steer: scale", _logarithms(0.75, 1.33)),
    "`max_steer`, or scale of steer, 0.85 or 1.2": ("steer: scale", _logarithms(0.85, 1.2)),
    "scale of the measured angle, 0.75 or 1.33": ("steer_angle: scale", _logarithms(0.75, 1.33)),
    "scale of the measured angle, 0.85 or 1.2": ("steer_angle: scale", _logarithms(0.85, 1.2)),
}
"""Errors of a rig: the quantity that each shifts, and its equally likely shifts."""


@dataclass(frozen=True)
class Measured:
    """Values by quantity in the recordings of one drive, where they are clear; of scales the logarithm."""

    seed: int
    healthy: dict[str, list[float]]


def warned(healthy: Sequence[float], shifts: Sequence[float], found: float) -> float:
    """Return the share of healthy values beyond the distance from their median that finds a share of the errors."""
    away = np.asarray(healthy) - np.median(healthy)
    limit = np.quantile(np.abs(away[:, None] + np.asarray(shifts)), 1 - found)
    return float(np.mean(np.abs(away) >= limit))


def measure(drive: TrueDrive, seed: int) -> Measured:
    """Measure the recordings of a drive."""
    healthy: dict[str, list[float]] = {}
    for number, one in enumerate((drive, scaled(drive, 0.2 if drive.wheelbase > 1 else 5.0))):
        case = recorded(one, np.random.default_rng([seed, number, 0xDE7]), {"throttle", "steer"})
        for name, value in _quantities(case).items():
            healthy.setdefault(name, []).append(value)
    return Measured(seed, healthy)


def _quantities(case: Case) -> dict[str, float]:
    """Centre, delays and scales of the controls, where they are clear."""
    drive = drive_from_log(case.log, case.rig)
    path = driven_path(drive)
    values: dict[str, float] = {}
    for name, steering in steering_fits(drive, path).items():
        if steering.dynamic.strength > _EFFECT:
            values[f"{name}: delay"] = steering.dynamic.delay(steering.dynamic.best(sign=1))[0]
        if steering.settled.strength > _CLEAR:
            values[f"{name}: centre"] = steering.centre
            values[f"{name}: scale"] = float(np.log(steering.curvature.value / curvature_per_unit(name, case.rig)))
    for name, pedal in pedal_fits(drive, path).items():
        if pedal.strength > _EFFECT:
            values[f"{name}: delay"] = pedal.delay(pedal.best(sign=1 if name == "throttle" else -1))[0]
    return values


@dataclass(frozen=True)
class Detectability(Study):
    """Measure what healthy logs can show."""

    out: Path = Path("detectability")
    logs: int = 59
    seed: int = 1001

    kind: ClassVar[type] = Measured

    def score(self, seed: int) -> Measured:
        """Measure the recordings of a drive."""
        return measure(drive_of(seed, self.drives), seed)

    def summary(self, score: Measured) -> str:
        """Which quantities are clear."""
        return f"{score.seed}: {', '.join(score.healthy)}"

    def report(self, scores: Sequence[Measured]) -> str:
        """The table as Markdown."""
        header = "| error | healthy recordings | warned at half found | at nine tenths found |"
        lines = [f"# What {len(scores)} drives can show", "", header, "|---|---|---|---|"]
        for error, (quantity, shifts) in ERRORS.items():
            values = [value for one in scores for value in one.healthy.get(quantity, ())]
            if values:
                half, most = (warned(values, shifts, found) for found in (0.5, 0.9))
                lines.append(f"| {error} | {len(values)} | {half:.0%} | {most:.0%} |")
        return "\n".join(lines) + "\n"


if __name__ == "__main__":
    run(Detectability)
