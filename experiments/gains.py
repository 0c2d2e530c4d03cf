"""Errors of runs on the same windows, and gains of models over a baseline with intervals."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from jaxtyping import Int

from offpiste.core.checksums import sha256_of_folders, sha256_of_json
from offpiste.core.errors import RunError
from offpiste.core.files import write_text
from offpiste.dataset.windows import Windows
from offpiste.evaluation.errors import Errors, SeededErrors, by_seed, load_errors, pool, save_errors
from offpiste.evaluation.evaluate import Reading
from offpiste.evaluation.intervals import NO_INTERVAL, Levels, PairedDifference, Resampling, Sampling, percent, relative
from offpiste.report.text_table import TextTable, number
from offpiste.reproduction.runs import PART, errors_of_runs
from offpiste.training.checkpoint import sha256_of_tensors
from offpiste.training.run import Run, refuse_seen


class Gain(msgspec.Struct, frozen=True, kw_only=True):
    """Gain of a model over a baseline on the same windows, as relative differences: -0.1 is 10 % less.

    Attributes:
        case: change of model, features or world.
        n: number of windows.
        levels: numbers of drives, blocks and seeds behind the intervals.
        error_m, baseline_error_m: mean distance errors after 5 s.
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


def gain(case: str, model: str, mine: Sequence[Errors], others: Sequence[Errors], reading: Reading) -> Gain:
    """Compare a model with `b` over the model's seeds; runs of both are in the order of their seeds."""
    one, other = runs_of(mine), runs_of(others[: len(mine)])
    drawn = Sampling().on(one)
    return Gain(
        case=case,
        model=model,
        baseline="b",
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
    """Return the errors of a model's runs, given in the order of their seeds."""
    return by_seed([pool([each]) for each in errors], range(len(errors)))


def share(
    mine: SeededErrors, base: SeededErrors, oracle: SeededErrors, oracle_base: SeededErrors, drawn: Resampling
) -> PairedDifference:
    """Share of an oracle's relative gain in distance that a model reaches: (1 - mine/base) / (1 - oracle/oracle_base).

    Each gain is over a baseline with the same normals, on the same windows in the same order. NaN if the interval of
    the oracle's gain includes zero.
    """
    values = [errors.distance() for errors in (mine, base, oracle, oracle_base)]
    if not all(np.isfinite(value).all() for value in values):
        return PairedDifference(np.nan, NO_INTERVAL)
    a, b, c, d = (drawn.means(value) for value in values)
    if not drawn.interval(1 - c / d)[0] > 0:
        return PairedDifference(np.nan, NO_INTERVAL)
    m, n, o, p = (value.mean() for value in values)
    return PairedDifference(float((1 - m / n) / (1 - o / p)), drawn.interval((1 - a / b) / (1 - c / d)))


def gain_table(title: str, gains: Sequence[Gain], about: str) -> TextTable:
    """Return a table with a line per gain."""
    lines = [
        (
            f"{g.model}, {g.case}" if g.case else g.model,
            " ".join(filter(None, (g.lookup, g.feature_set))),
            number(g.error_m),
            number(g.baseline_error_m),
            percent(g.distance),
            percent(g.loss),
            f"{g.n}",
            g.levels.text(),
        )
        for g in gains
    ]
    names = ("model", "lookup", "error [m]", "baseline [m]", "distance error", "loss", "windows", "intervals over")
    caveats = [caveat for caveat in dict.fromkeys(g.levels.caveat for g in gains) if caveat]
    return TextTable(title, names, tuple(lines), " ".join((about, *caveats)))


def write_control(folder: Path, tables: Sequence[TextTable], results: Mapping[str, Any]) -> Path:
    """Write control.md, which is returned, and control.json."""
    write_text(folder / "control.json", msgspec.json.format(msgspec.json.encode({"schema": 1, **results})).decode())
    write_text(folder / "control.md", "\n".join(table.markdown() for table in tables))
    return folder / "control.md"


def same_windows(windows: Windows, index: Int[np.ndarray, " n"], among: Windows) -> Int[np.ndarray, " n"]:
    """Return the indices of windows, by drive and row, in another dataset of the same drives.

    Raises:
        RunError: a window is missing.
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
    run: Run, windows: Windows, index: Int[np.ndarray, " n"], reading: Reading, *, scale: torch.Tensor, kept: Path
) -> Errors:
    """Read the errors of a run on some windows from the folder `kept`; compute and store them if they are missing.

    Args:
        scale: units of the loss, the same for all compared runs.

    Raises:
        RunError: the windows are of the test part, and the run was trained or chosen on some of them.
    """
    if windows.part == PART:
        refuse_seen(run, windows.dataset, PART)
    weights = sha256_of_tensors(run.dynamics.state_dict(), {})
    chosen = [windows.drive[index].tolist(), windows.row_in_drive(index).tolist()]
    of = sha256_of_json([weights, sha256_of_folders(windows.dataset.path), scale.tolist(), chosen])[:12]
    path = kept / run.folder.name / f"{'-'.join((*filter(None, reading), of))}.safetensors"
    if not path.exists():
        save_errors(path, errors_of_runs([run], windows, index, reading, scale=scale)[0])
    return load_errors(path)
