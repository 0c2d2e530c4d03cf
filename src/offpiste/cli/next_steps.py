"""Suggestions of the next command; `options` are the dataclass of the finished command."""

from collections.abc import Sequence
from contextlib import suppress
from itertools import chain, count
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Any

from offpiste.core.command_line import options as options_of
from offpiste.core.object_store import url_of

if TYPE_CHECKING:
    from offpiste.dataset.store import Dataset
    from offpiste.inspection.inspect import Inspection


def next_line(*words: object, first: Sequence[str] = ()) -> str:
    """Return the line of the next command.

    Args:
        words: command without `offpiste`.
        first: steps before it.
    """
    command = join(["offpiste", *(url_of(str(word)) or str(word) for word in words)])
    return "\n".join([*(f"first: {what}" for what in first), f"next: {command}"])


def after_inspection(options: Any, log: str, inspection: "Inspection") -> str:
    """Return the command that improves the rig of a log, or extracts the log."""
    from offpiste.inspection.missing import BY_HAND
    from offpiste.rig.rig import rig_text

    rig = str(options.write_rig) if options.write_rig else options.rig
    undrafted = [finding.remedy for finding in inspection.findings if finding.code == "undrafted"]
    if undrafted and BY_HAND in undrafted[0]:
        own = _another("my.toml")
        by_hand = f"write {own} by hand, with the fields of a position and a heading (docs/rig.md)"
        return next_line("inspect", log, "--rig", own, first=[by_hand])
    if undrafted:
        return next_line("inspect", log, first=["make the log readable as said above"])
    if not rig:
        given = (("--time", options.time), ("--namespace", options.namespace))
        same = [word for option, value in given if value for word in (option, value)]
        return next_line("inspect", log, *same, "--write-rig", "my.toml")
    again = ("inspect", log, "--rig", rig)
    vehicle = f"give {rig} the numbers of your vehicle ([vehicle])"
    if "?" in rig_text(rig):
        vehicle += ", and answer what its comments ask"
    if options.write_rig and not options.rig:
        return next_line(*again, first=[vehicle])
    if inspection.cure:
        return next_line(*again, *(() if options.write_rig else ("--write-rig", _another(rig))))
    if not inspection.usable:
        if not rig.endswith(".toml"):  # a preset, of another vehicle
            return next_line("inspect", log, "--write-rig", _another(rig))
        return next_line(*again, first=[f"correct {rig} as said above"])
    before = [vehicle] if any(finding.code == "drafted_vehicle" for finding in inspection.findings) else []
    if any(finding.severity == "warning" for finding in inspection.findings):
        before.append("fix what the warnings say, or leave it where the log has no better")
    return after_logs([log], rig, first=before)


def after_logs(logs: Sequence[object], rig: str, *more: object, first: Sequence[str] = ()) -> str:
    """Return the command that extracts logs."""
    return next_line("extract", *logs, "--rig", rig, *more, "--out", _dataset(rig), first=first)


def after_survey(logs: Sequence[str], rig: str | None, *, usable: bool) -> str:
    """Return the command that extracts inspected logs, or drafts a rig for the first."""
    if rig and usable:
        return after_logs(logs, rig)
    return next_line("inspect", logs[0], *(("--rig", rig) if rig else ()), "--write-rig", _another("my.toml"))


def after_extraction(options: Any, dataset: "Dataset") -> str:
    """Return the command that trains on a dataset, merges shards, or extracts it again with a better split."""
    from offpiste.core.parallel import parse_shard
    from offpiste.dataset.split_balance import is_for_tests, next_split

    if options.shard and parse_shard(options.shard)[1] > 1:
        first = ["extract the other shards to datasets of their own"]
        return next_line("merge", options.out, "...", "--out", _dataset(options.rig), first=first)
    if is_for_tests(dataset.split):
        return next_line("evaluate", "RUN", "--dataset", options.out)
    if (split := next_split(dataset)) is not None:
        other = options.out.with_name(f"{options.out.stem}-2{options.out.suffix}")
        return next_line("extract", *options.logs, *options_of(options, "logs", split=split.text, out=other))
    return after_dataset(dataset, options.out)


def after_dataset(dataset: "Dataset", path: Path) -> str:
    """Return the command that trains a first model on a dataset."""
    from offpiste.dataset.split_balance import has_little_driving, lacks_windows

    if lacks_windows(dataset):
        return "next: record more or longer drives; a part of the split has no window, so training is impossible"
    return _training(path, "dc" if dataset.pca else "parametric" if has_little_driving(dataset) else "b")


def after_evaluation(runs: Sequence[Path], path: Path) -> str:
    """Return the command that calibrates runs without a spread if possible, or `after_runs`."""
    from offpiste.core.shipped import run_folder
    from offpiste.training.checkpoint import fold_folders
    from offpiste.training.run import load_run, model_trained_on
    from offpiste.uncertainty.fit import FILE

    if folds := [fold for run in runs for fold in fold_folders(run_folder(run))]:
        return _training(path, load_run(folds[0]).model)
    without = [folder for run in runs if not ((folder := run_folder(run)) / FILE).exists()]
    if without and all(model_trained_on(folder, path) for folder in without):
        return next_line("calibrate", *runs, "--dataset", path)
    return after_runs(runs, path)


def after_runs(runs: Sequence[Path], dataset: Path) -> str:
    """Return the command that drives with a pretrained model or exports a run."""
    from offpiste.core.shipped import PREFIX
    from offpiste.dynamics.kernels.coverage import uncovered, uncovered_encoder
    from offpiste.training.run import load_run

    for run in runs:
        if str(run).startswith(PREFIX):
            return next_line("drive", run, "--out", _free("closed-loop"))
        dynamics = load_run(run).dynamics
        if not (uncovered(dynamics) or uncovered_encoder(dynamics.encoder)):
            return next_line("export", run, "--to", _free(f"{run.name}-c"))
    return _training(dataset, "b")


def after_view(options: Any) -> str:
    """Return the command that extracts a viewed log, trains on a viewed dataset, or uses the viewed run."""
    from offpiste.dataset.store import open_dataset

    if options.rig is not None and not (options.path / "zarr.json").exists():
        return after_logs([options.path], options.rig, *(("--pca", options.pca) if options.pca else ()))
    if options.run_folder is not None:
        return after_runs([options.run_folder], options.path)
    return after_dataset(open_dataset(options.path), options.path)


def _training(path: Path, model: str) -> str:
    return next_line("train", path, "--model", model, "--out", _free(f"runs/{model}"))


def _free(name: str) -> str:
    """Return the path, with a number before its suffix if it exists."""
    path = Path(name)
    others = (path.with_name(f"{path.stem}-{number}{path.suffix}") for number in count(2))
    return str(next(one for one in chain([path], others) if not one.exists()))


def _another(rig: str) -> str:
    """Return a new file name for an edited rig."""
    return _free(rig if rig.endswith(".toml") else "my.toml")


def _dataset(rig: str) -> str:
    """Return a name for a dataset: the usual one if it does not exist yet or has this rig."""
    from offpiste.core.errors import OffpisteError
    from offpiste.dataset.store import open_dataset  # takes a second, and is rarely needed
    from offpiste.rig.rig import load_rig

    if (usual := Path("dataset.zarr")).exists():
        with suppress(OffpisteError):
            return str(usual) if open_dataset(usual).rig == load_rig(rig) else _free(str(usual))
    return _free(str(usual))
