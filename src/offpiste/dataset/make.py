"""Logs in, dataset out: split once, every drive extracted by itself, several at a time."""

from collections.abc import Callable, Sequence
from pathlib import Path

from offpiste.dataset.ground_truth import LAYERS, FeatureSource
from offpiste.dataset.hindsight import MIN_HINDSIGHT
from offpiste.dataset.one_drive import Job, extract_drive
from offpiste.dataset.snapshots import SnapshotSettings
from offpiste.dataset.splits import empty_parts, parse_split
from offpiste.dataset.store import Dataset, create, drive_names, open_dataset
from offpiste.errors import DatasetError, OffpisteError
from offpiste.logs.drive import drive_name
from offpiste.mapping.replay import ReplaySettings
from offpiste.parallel import run_all, usable_cores
from offpiste.perception.looking import load_looking
from offpiste.rig import Rig


def make_dataset(
    logs: Sequence[str | Path],
    rig: Rig,
    out: Path,
    *,
    split: str = "blocks:0.7,0.1,0.2",
    features: FeatureSource = "none",
    pca: Path | None = None,
    device: str = "cpu",
    min_hindsight: float = MIN_HINDSIGHT,
    snapshots: SnapshotSettings | None = None,
    replay: ReplaySettings | None = None,
    processes: int = 1,
    tell: Callable[[str], None] = lambda line: None,
) -> Dataset:
    """Extract drives into a dataset; drives that are in it already are left as they are.

    Args:
        features: what a simulator says of the ground under the wheels (`dataset.ground_truth.LAYERS`).
        pca: instead, visual features: a file of `fit-pca`, which names its backbone.
        device: that the backbone runs on.
        min_hindsight: windows with less of their ground seen in hindsight are left out (`dataset.hindsight`).
        snapshots, replay: of visual features.
        processes: drives that are extracted at a time; 0: one a core, or one where the backbone runs on a GPU.

    Raises:
        LogError, RigError: a log cannot be read with this rig, or has no ground truth; the others are extracted.
        DatasetError: two logs of one name, another dataset at `out`, or several logs that cannot be extracted.
    """
    if not logs:
        raise DatasetError("no log is given", how="name one or more logs")
    names = [drive_name(log) for log in logs]
    for name in names:
        if names.count(name) > 1:
            raise DatasetError(f"two logs are called '{name}'", how="rename one of them")
    parts = parse_split(split)
    if empty := empty_parts(parts):
        tell(f"warning: the split {split} leaves nothing for {' and '.join(empty)}: {_useless(empty)}")
    if pca is not None and features != "none":
        raise DatasetError(f"both a PCA and '{features}' features are asked for", how="leave out one of them")
    if not 0 <= min_hindsight <= 1:
        raise DatasetError(f"min-hindsight is {min_hindsight:g}", how="give a share from 0 to 1")
    looking = load_looking(pca, device) if pca is not None else None
    if looking is None:
        create(out, rig, parts, LAYERS[features])
    else:
        create(out, rig, parts, looking.names, looking.identity, min_hindsight)
    done = set(drive_names(out))
    for name in (name for name in names if name in done):
        tell(f"{name}: already there")
    jobs = [
        Job(Path(log), name, rig, out, parts, features, pca, device, min_hindsight, snapshots, replay)
        for log, name in zip(logs, names, strict=True)
        if name not in done
    ]
    processes = processes or (usable_cores() if device == "cpu" else 1)
    _refuse_failed(run_all(extract_drive, jobs, processes, "extract", tell), out)
    return open_dataset(out)


def _useless(empty: Sequence[str]) -> str:
    return "models cannot be " + " or ".join(
        [*(["trained"] if {"train", "validation"} & set(empty) else []), *(["judged"] if "test" in empty else [])]
    )


def _refuse_failed(failed: Sequence[OffpisteError], out: Path) -> None:
    if len(failed) == 1:
        raise failed[0]
    if failed:
        raise DatasetError(
            f"{len(failed)} logs could not be extracted, as said above; the others were",
            where=out,
            how="mend or leave out those logs and run it again: it goes on where it stopped",
        )
