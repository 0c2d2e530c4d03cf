"""Errors of runs on the same windows, kept in files, and what one model gains over another."""

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
import torch
from jaxtyping import Int

from offpiste.core.checksums import sha256_of_folders, sha256_of_json
from offpiste.core.errors import RunError
from offpiste.dataset.windows import Windows
from offpiste.evaluation.errors import Errors, SeededErrors, by_seed, pool, save_errors, saved_errors
from offpiste.evaluation.evaluate import Reading
from offpiste.evaluation.intervals import Levels, PairedDifference, Resampling, Sampling, relative
from offpiste.report.text_table import TextTable, interval, number
from offpiste.reproduction.runs import PART, evaluation_windows, run_errors
from offpiste.training.checkpoint import sha256_of_tensors
from offpiste.training.prediction import MapSource, on_map
from offpiste.training.run import Run, refuse_seen

MAP: Reading = ("map", None)
HINDSIGHT: Reading = ("recorded", "hindsight")


class Gain(msgspec.Struct, frozen=True, kw_only=True):
    """What a model gains over a baseline on the same windows; relative differences: -0.1 is 10 % below.

    Attributes:
        case: what was done to model, features or world.
        model, baseline: their names; n: windows.
        levels: numbers of drives, blocks and seeds that intervals are drawn from.
        error_m, baseline_error_m: mean distances after 5 s.
        distance, loss: relative differences with 95 % intervals over drives, blocks of 10 s and seeds.
    """

    case: str
    model: str
    baseline: str
    lookup: str
    feature_set: str | None
    n: int
    levels: Levels
    error_m: float
    baseline_error_m: float
    distance: PairedDifference
    loss: PairedDifference


def evaluation_index(windows: Windows, reading: Reading, stride: int, *, most: int = 0) -> Int[np.ndarray, " n"]:
    """Windows of a reproduction that are evaluated with one terrain lookup.

    Args:
        most: so many of them, evenly spread; 0: all.
    """
    index = evaluation_windows(windows, reading, stride)
    if 0 < most < len(index):
        index = index[np.unique(np.linspace(0, len(index) - 1, most).astype(int))]
    return index


def same_windows(windows: Windows, index: Int[np.ndarray, " n"], among: Windows) -> Int[np.ndarray, " n"]:
    """The same windows, drive and row, of another dataset of the same drives.

    Raises:
        RunError: one is not there.
    """
    numbers = [among.drive_names.index(name) if name in among.drive_names else -1 for name in windows.drive_names]
    wanted = np.array(numbers)[windows.drive[index]].astype(np.int64) << 32 | windows.row_in_drive(index)
    every = np.arange(len(among))
    keys = among.drive.astype(np.int64) << 32 | among.row_in_drive(every)
    result = np.searchsorted(keys, wanted).clip(max=len(keys) - 1)
    if not np.array_equal(keys[result], wanted):
        raise RunError("two datasets do not hold the same windows", how="extract both from the same logs")
    return result


def errors_of(
    run: Run,
    windows: Windows,
    index: Int[np.ndarray, " n"],
    reading: Reading,
    *,
    scale: torch.Tensor,
    kept: Path,
    map_source: MapSource = on_map,
) -> Errors:
    """Errors of a run, from `kept` if they are there; else they are computed and kept.

    Kept ones are of the same weights, dataset, units of the loss and windows.

    Args:
        scale: of the loss, the same for all that is compared.
        map_source: the map that is read, where it is not the windows' own.

    Raises:
        RunError: the windows test, and the run was trained or chosen on some of them.
    """
    if windows.part == PART:  # ideas are chosen on windows that validate, as epochs are
        refuse_seen(run, windows.dataset, PART)
    weights = sha256_of_tensors(run.dynamics.state_dict(), {})  # a run may be trained again in its folder
    of = sha256_of_json([weights, sha256_of_folders(windows.dataset.path), scale.tolist()])[:12]
    path = kept / run.folder.name / f"{'-'.join((*filter(None, reading), of))}.safetensors"

    def compute() -> Errors:
        return run_errors(run, windows, index, reading, scale=scale, map_source=map_source)

    errors = saved_errors(path, compute)
    if not (
        np.array_equal(errors.drive, windows.drive[index]) and np.array_equal(errors.row, windows.row_in_drive(index))
    ):
        errors = compute()  # kept were those of other windows
        save_errors(path, errors)
    return errors


def gain(
    case: str, model: str, mine: Sequence[Errors], others: Sequence[Errors], reading: Reading, *, baseline: str = "b"
) -> Gain:
    """A model against a baseline, over the model's seeds; runs of both are in the order of their seeds."""
    one, other = runs_of(mine), runs_of(others[: len(mine)])
    drawn = Sampling().on(one)
    return Gain(
        case=case,
        model=model,
        baseline=baseline,
        lookup=str(reading[0]),
        feature_set=reading[1],
        n=len(one.row),
        levels=drawn.levels(len(mine)),
        error_m=float(one.distance().mean()),
        baseline_error_m=float(other.distance().mean()),
        distance=relative(one.distance(), other.distance(), drawn),
        loss=relative(one.loss, other.loss, drawn),
    )


def runs_of(errors: Sequence[Errors]) -> SeededErrors:
    """Runs of a model on the same windows, in the order of their seeds."""
    return by_seed([pool([each]) for each in errors], range(len(errors)))


def share(
    mine: SeededErrors, base: SeededErrors, oracle: SeededErrors, oracle_base: SeededErrors, drawn: Resampling
) -> PairedDifference:
    """What part of an oracle's relative gain in distance a model reaches: (1 - mine/base) / (1 - oracle/oracle_base).

    Each gain is over a baseline that reads the same normals. All are of the same windows, in the same order. Where the
    oracle's own gain is not surely above zero there is nothing to have a share of: NaN.
    """
    values = [errors.distance() for errors in (mine, base, oracle, oracle_base)]
    if not all(np.isfinite(value).all() for value in values):
        return PairedDifference(np.nan, (np.nan, np.nan))
    a, b, c, d = (drawn.means(value) for value in values)
    if not drawn.interval(1 - c / d)[0] > 0:
        return PairedDifference(np.nan, (np.nan, np.nan))
    m, n, o, p = (value.mean() for value in values)
    return PairedDifference(float((1 - m / n) / (1 - o / p)), drawn.interval((1 - a / b) / (1 - c / d)))


def gain_table(title: str, gains: Sequence[Gain], about: str) -> TextTable:
    """A line a gain."""
    lines = [
        (
            f"{g.model}, {g.case}" if g.case else g.model,
            " ".join(filter(None, (g.lookup, g.feature_set))),
            number(g.error_m),
            number(g.baseline_error_m),
            _percent(g.distance),
            _percent(g.loss),
            f"{g.n}",
            g.levels.text(),
        )
        for g in gains
    ]
    names = ("model", "lookup", "error [m]", "baseline [m]", "distance error", "loss", "windows", "intervals over")
    caveats = [caveat for caveat in dict.fromkeys(g.levels.caveat for g in gains) if caveat]
    return TextTable(title, names, tuple(lines), " ".join((about, *caveats)))


def _percent(difference: PairedDifference) -> str:
    low, high = (100 * bound for bound in difference.ci95)
    return f"{number(100 * difference.mean, 1)} % {interval((low, high), 1)}"
