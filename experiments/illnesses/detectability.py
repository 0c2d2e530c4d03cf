"""What a log can show at all: how far healthy vehicles differ in what an error of a rig would change.

    python -m experiments.illnesses.detectability --out detectability

Each drive is recorded twice, the second time as a vehicle of another size. What the checks measure in healthy
recordings (centre, delays and scales) scatters; an error shifts it, so the scatter alone says how many healthy logs a
limit warns about that finds half, or nine tenths, of the errors. Also: controls that are cut off, and how far the cost
of an illness depends on the choice of windows.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

import msgspec
import numpy as np

from experiments.command import run
from experiments.illnesses import channel_illnesses, results  # noqa: F401  declared there: what is cut off
from experiments.illnesses.drives import drive_of
from experiments.illnesses.effect import FEW, MANY, error_after, rows_of
from experiments.illnesses.illness import ILLNESSES
from experiments.illnesses.logger import recorded
from experiments.illnesses.recording import Case
from experiments.illnesses.score import COSTLY
from experiments.illnesses.table import share
from experiments.illnesses.true_drive import TrueDrive, scaled
from offpiste.core.files import check_folder
from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.pedals import pedal_fits
from offpiste.inspection.range_ends import check_range_ends
from offpiste.inspection.steering_fit import curvature_per_unit, steering_fits
from offpiste.logs.drive import drive_from_log

T = TypeVar("T")

_CLEAR: Final = 0.7
"""Correlation above which centre and scale of a steering are clear."""
_EFFECT: Final = 0.3
"""Correlation above which a control has an effect, and so a delay."""
_LATER: Final = (0.3, 0.6, 1.0, 2.0)
"""Seconds by which the first window moves, for another choice of windows."""
_CUT: Final = ("throttle: clipped", "throttle: scale", "steer: clipped")


class Measured(msgspec.Struct, frozen=True):
    """What was measured in the recordings of one drive.

    Attributes:
        healthy: values by quantity, one for each healthy recording in which it is clear; of scales the logarithm.
        ends: whether a control is said to end short of its range, by illness and strength; "healthy" of none.
        changes: of the cost's error with other windows of the same log [relative], by the number of windows.
    """

    seed: int
    healthy: dict[str, list[float]]
    ends: dict[str, list[bool]]
    changes: dict[int, list[float]]


@dataclass(frozen=True)
class Error:
    """Errors of a rig that shift a quantity: delays and offsets by what they are, scales by their logarithm."""

    name: str
    quantity: str
    shifts: tuple[float, ...]


def _scales(*factors: float) -> tuple[float, ...]:
    return tuple(float(np.log(factor)) for factor in factors)


ERRORS: Final = (
    Error("steer: offset 0.02", "steer: centre", (-0.02, 0.02)),
    Error("steer: offset 0.05", "steer: centre", (-0.05, 0.05)),
    *(
        Error(f"{name} late or early by {late} s", f"{name}: delay", (-late, late))
        for name in ("steer", "brake", "throttle")
        for late in (0.1, 0.2)
    ),
    Error("`max_steer`, or scale of steer, 0.75 or 1.33", "steer: scale", _scales(0.75, 1.33)),
    Error("`max_steer`, or scale of steer, 0.85 or 1.2", "steer: scale", _scales(0.85, 1.2)),
    Error("scale of the measured angle, 0.75 or 1.33", "steer_angle: scale", _scales(0.75, 1.33)),
    Error("scale of the measured angle, 0.85 or 1.2", "steer_angle: scale", _scales(0.85, 1.2)),
)
"""What is asked for; the shifts of an error are equally likely."""


def warned(healthy: Sequence[float], shifts: Sequence[float], found: float) -> float:
    """Share of healthy logs beyond the limit that finds a share of the errors.

    Args:
        healthy: values of a quantity; the limit is on the distance from their median.
        shifts: what an error adds to each value.
        found: share of the errors beyond the limit.
    """
    away = np.asarray(healthy) - np.median(healthy)
    limit = np.quantile(np.abs(away[:, None] + np.asarray(shifts)), 1 - found)
    return float(np.mean(np.abs(away) >= limit))


def measure(drive: TrueDrive, seed: int) -> Measured:
    """Measure the recordings of a drive."""
    resized = scaled(drive, 0.2 if drive.wheelbase > 1 else 5.0)
    recordings = [
        recorded(one, np.random.default_rng([seed, i, 0xDE7]), {"throttle", "steer"})
        for i, one in enumerate((drive, resized))
    ]
    healthy: dict[str, list[float]] = {}
    for case in recordings:
        for name, value in _quantities(case).items():
            healthy.setdefault(name, []).append(value)
    return Measured(seed, healthy, _ends(recordings), _changes(recordings[0]))


def _quantities(case: Case) -> dict[str, float]:
    """Centre, delays and scales of the controls, where they are clear."""
    drive = drive_from_log(case.log, case.rig)
    path = driven_path(drive)
    values: dict[str, float] = {}
    for name, steering in steering_fits(drive, path, measured=True).items():
        gripping = steering.gripping
        if steering.dynamic.strength > _EFFECT:
            values[f"{name}: delay"] = steering.dynamic.delay(steering.dynamic.best(sign=1))[0]
        if gripping.strength > _CLEAR:
            values[f"{name}: centre"] = steering.centre
            gain = abs(float(gripping.gain[gripping.best()]))
            values[f"{name}: scale"] = float(np.log(gain / curvature_per_unit(name, case.rig)))
    for name, pedal in pedal_fits(drive, path).items():
        if pedal.strength > _EFFECT:
            values[f"{name}: delay"] = pedal.delay(pedal.best(sign=1 if name == "throttle" else -1))[0]
    return values


def _ends(recordings: Sequence[Case]) -> dict[str, list[bool]]:
    def ends(case: Case) -> list[str]:
        return [finding.where for finding in check_range_ends(drive_from_log(case.log, case.rig))]

    said: dict[str, list[bool]] = {"healthy": [bool(ends(case)) for case in recordings]}
    for name in _CUT:
        for strength in ILLNESSES[name].strengths:
            sick = ILLNESSES[name].change(recordings[0], strength, np.random.default_rng(0))
            said[f"{name}, {strength:g}"] = [name.partition(":")[0] in ends(sick)]
    return said


def _changes(case: Case) -> dict[int, list[float]]:
    readable = rows_of(case)
    if readable is None:
        return {}
    changes: dict[int, list[float]] = {}
    for windows in (FEW, MANY):
        begins = readable.rows.time[0] + np.array((0.0, *_LATER))
        first, *others = (error_after(readable, readable, windows, begin=float(begin)) for begin in begins)
        changes[windows] = [other / first - 1 for other in others if np.isfinite(other) and np.isfinite(first)]
    return changes


def _together(parts: Sequence[Mapping[str, Sequence[T]]]) -> dict[str, list[T]]:
    """Values of the same key, of all parts."""
    keys = dict.fromkeys(key for part in parts for key in part)
    return {key: [value for part in parts for value in part.get(key, ())] for key in keys}


def report(measured: Sequence[Measured]) -> str:
    """The three tables as Markdown."""
    healthy, ends = _together([one.healthy for one in measured]), _together([one.ends for one in measured])
    limits = [
        f"| {error.name} | {len(healthy[error.quantity])} | {warned(healthy[error.quantity], error.shifts, 0.5):.0%} |"
        f" {warned(healthy[error.quantity], error.shifts, 0.9):.0%} |"
        for error in ERRORS
        if error.quantity in healthy
    ]
    costs = [_noise(windows, [c for one in measured for c in one.changes.get(windows, ())]) for windows in (FEW, MANY)]
    lines = [
        f"# What {len(measured)} drives can show",
        "| error | healthy recordings | warned at half found | at nine tenths found |\n|---|---|---|---|\n"
        + "\n".join(limits),
        "| control | said to end short of its range |\n|---|---|\n"
        + "\n".join(f"| {name} | {share(sum(said), len(said))} |" for name, said in ends.items()),
        "| windows | change of the error by other ones: median | nine tenths below | costs 5 % |\n|---|---|---|---|\n"
        + "\n".join(costs),
    ]
    return "\n\n".join(lines) + "\n"


def _noise(windows: int, changes: Sequence[float]) -> str:
    if not changes:
        return f"| {windows} | not known | | |"
    median, most = np.quantile(np.abs(changes), (0.5, 0.9))
    return f"| {windows} | {median:.1%} | {most:.1%} | {np.mean(np.asarray(changes) >= COSTLY):.0%} |"


@dataclass(frozen=True)
class Detectability:
    """Measure what healthy logs can show.

    Attributes:
        out: folder of results: a JSON line for each drive, and report.md; what is there is not done again.
        drives: number of drives.
        seed: of the first drive; the others follow.
        processes: drives at a time.
        cache: folder of simulated drives; OUT/drives if not given.
    """

    out: Path = Path("detectability")
    drives: int = 59
    seed: int = 1001
    processes: int = 1
    cache: Path | None = None

    def run(self) -> str:
        """Measure the drives that are missing, and report."""
        check_folder(self.out)
        seeds = range(self.seed, self.seed + self.drives)
        work = partial(_work, self.out / "measured.jsonl", self.cache or self.out / "drives")
        return results.reported(self.out / "measured.jsonl", Measured, seeds, work, report, processes=self.processes)


def _work(path: Path, cache: Path, seed: int, progress: Callable[[float], None]) -> str:
    drive = drive_of(seed, cache)
    results.append(path, measure(drive, seed))
    return f"{seed}: {drive.behaviour}, {drive.seconds:.0f} s"


if __name__ == "__main__":
    run(Detectability)
