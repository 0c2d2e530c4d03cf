"""Whether a run may be evaluated on a dataset: one that it has not seen, with the features and channels it reads."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple, Protocol, runtime_checkable

import numpy as np

from offpiste.core.channels import without_optional
from offpiste.core.checksums import sha256_of_arrays
from offpiste.core.conventions import DT
from offpiste.core.errors import RunError
from offpiste.core.shipped import PREFIX, named
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dynamics import Dynamics, Vehicle
from offpiste.rig.rig import Vehicle as RigVehicle
from offpiste.training.build import vehicle_of

ALIKE: Final = 0.1
"""Share by which vehicles may differ in a measure and still count as the same."""


class Stretch(NamedTuple):
    """A stretch of a drive that something was fitted to: from `first` to `last` [s].

    Attributes:
        rows: digest of the drive's rows, by which it is known under another name; empty in older files.
    """

    drive: str
    first: float
    last: float
    rows: str = ""


@runtime_checkable
class TrainedRun(Protocol):
    """What is compared with a dataset: a part of `training.run.Run`."""

    @property
    def folder(self) -> Path:
        """Where it was read from."""
        ...

    @property
    def dynamics(self) -> Dynamics:
        """The model."""
        ...

    @property
    def pca(self) -> str | None:
        """Digest of the PCA whose features it reads."""
        ...

    @property
    def features(self) -> tuple[str, ...]:
        """Names of the features that it reads."""
        ...

    @property
    def seen(self) -> tuple[Stretch, ...]:
        """What it was trained or chosen on."""
        ...


def refuse_seen(run: TrainedRun, dataset: Dataset, part: str) -> None:
    """Raise if a part of a dataset holds moments that the run was trained or chosen on.

    Raises:
        RunError: names the drive and the overlap.
    """
    if (overlap := overlap_with(run.seen, dataset, part)) is not None:
        what = f"was trained on {overlap.seconds:.0f} s of the {part} part of drive '{overlap.drive}'"
        how = "evaluate it on the dataset and split it was trained with, or on another drive"
        raise RunError(what, where=run.folder, how=how)


class Overlap(NamedTuple):
    """A drive, and how much of what a part holds of it something was fitted to."""

    drive: str
    seconds: float


def overlap_with(seen: Sequence[Stretch], dataset: Dataset, part: str) -> Overlap | None:
    """The first stretch that something was fitted to and that a part of a dataset holds moments of; None for none.

    A drive is the same by its name, or by its rows: a log that was renamed.
    """
    number, known = PARTS.index(part), {stretch.rows for stretch in seen} - {""}
    for drive in dataset.drives:
        evaluated = drive.rows.time[drive.part == number]
        rows = _digest_of_rows(drive) if known and len(evaluated) else ""
        for name, first, last, theirs in seen:
            same = name == drive.name or (theirs and theirs == rows)
            count = np.count_nonzero((evaluated >= first) & (evaluated <= last)) if same else 0
            if count:
                named_so = drive.name if name == drive.name else f"{drive.name} (there: {name})"
                return Overlap(named_so, count * DT)
    return None


def seen_stretches(dataset: Dataset) -> list[Stretch]:
    """Stretches of drives in the parts that training and validation read."""
    stretches = []
    for drive in dataset.drives:
        used = np.isin(drive.part, (PARTS.index("train"), PARTS.index("validation")))
        edges = np.flatnonzero(np.diff(np.concatenate(([False], used, [False])).astype(int)))
        rows = _digest_of_rows(drive) if len(edges) else ""
        for first, last in edges.reshape(-1, 2):
            stretches.append(Stretch(drive.name, float(drive.rows.time[first]), float(drive.rows.time[last - 1]), rows))
    return stretches


def _digest_of_rows(drive: StoredDrive) -> str:
    rows = drive.rows
    return sha256_of_arrays(
        {"time": rows.time, "state": rows.state, "control": rows.control, "origin": rows.origin}, {}
    )


def _extracted_with(run: TrainedRun) -> str:
    """The option of `extract` that gives the features that a run reads."""
    if run.pca is None:
        return "the same --features"
    name = named(run.folder)
    return f"--pca {name.rpartition('/')[0]}" if name.startswith(PREFIX) else "--pca and the PCA of its training"


def refuse_unfit(run: TrainedRun, dataset: Dataset) -> None:
    """Raise if a run's features or channels are not those of a dataset.

    Raises:
        RunError: says what it was trained with.
    """
    needed, given = run.dynamics.vehicle, vehicle_of(dataset)
    reads = run.dynamics.encoder is not None
    if reads and needed.features != given.features:
        raise RunError(
            f"reads {needed.features} terrain features; the dataset has {given.features}",
            where=named(run.folder),
            how=f"use a dataset that was extracted with {_extracted_with(run)}",
        )
    if reads and run.pca is not None and dataset.pca is not None and run.pca != dataset.pca:
        raise RunError(
            f"reads features of the PCA {run.pca}; the dataset's are of {dataset.pca}",
            where=named(run.folder),
            how="evaluate it on a dataset that was extracted with the PCA of its training",
        )
    if reads and run.features and run.features != dataset.features:
        raise RunError(
            f"reads the terrain features {_listed(run.features)}; the dataset has {_listed(dataset.features)}",
            where=named(run.folder),
            how="evaluate it on a dataset with the same",
        )
    for kind in ("control", "actuators"):
        if without_optional(getattr(needed, kind)) != without_optional(getattr(given, kind)):
            raise RunError(
                f"was trained with {kind} {', '.join(getattr(needed, kind)) or 'none'}; the dataset has "
                f"{', '.join(getattr(given, kind)) or 'none'}",
                where=named(run.folder),
                how="evaluate it on a dataset whose rig has the same channels",
            )


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (" …" if len(names) > 4 else "")


def differing_vehicle(trained: Vehicle, driven: RigVehicle) -> str | None:
    """How the vehicle that a model was trained on differs from the one that it drives, in words; None: hardly."""
    apart = [
        f"{name} {mine:.4g} {unit}, not {its:.4g}"
        for name, mine, its, unit in (
            ("wheelbase", trained.wheelbase, driven.wheelbase, "m"),
            ("mass", trained.mass, driven.mass, "kg"),
            ("max_steer", trained.max_steer, driven.max_steer, "rad"),
        )
        if abs(mine - its) > ALIKE * its
    ]
    return ", ".join(apart) or None
