"""Trained models on disk (runs): building, loading and saving them, and whether one may be evaluated on a dataset."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.channels import without_optional
from offpiste.core.checksums import sha256_of, sha256_of_arrays
from offpiste.core.conventions import DT
from offpiste.core.errors import RunError
from offpiste.core.shipped import PREFIX, alike, named, run_folder
from offpiste.core.state import Trajectory
from offpiste.dataset.assumptions import assumptions_of
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dataset.windows import Windows
from offpiste.dynamics import MODELS, Dynamics, Vehicle
from offpiste.rig.rig import Vehicle as RigVehicle
from offpiste.training.checkpoint import WEIGHTS, load_json, load_tensors, load_weights, save_json, save_tensors
from offpiste.training.config import MOST_CODES, TrainConfig, Weights
from offpiste.training.loop import BestEpoch
from offpiste.training.losses import COMPONENTS, LARGEST_SCALE
from offpiste.training.prediction import Lookup, predict_windows

SCHEMA: Final = 2
"""Version of a run: of its files, and of the physics that its weights belong to."""

ALIKE: Final = 0.1
"""Relative difference up to which measures of two vehicles count as the same."""

_MOST_FEATURES: Final = 1 << 16
"""Largest number of terrain features; no backbone has as many."""


def vehicle_of(dataset: Dataset, config: TrainConfig | None = None) -> Vehicle:
    """Return the vehicle of a dataset for models with the features and code length of a training."""
    rig, config = dataset.rig, config or TrainConfig()
    return Vehicle(
        mass=rig.vehicle.mass,
        wheelbase=rig.vehicle.wheelbase,
        max_steer=rig.vehicle.max_steer,
        control=rig.present_controls,
        actuators=rig.present_actuators,
        rear_axle=rig.vehicle.rear_axle,
        features=len(dataset.features),
        pca=config.pca,
        codes=config.codes,
        track=rig.vehicle.track,
    )


def build(model: str, vehicle: Vehicle, *, seed: int) -> Dynamics:
    """Return an untrained model whose initial weights follow from the seed.

    Raises:
        RunError: unknown model, or the dataset has no or fewer features than it reads.
    """
    make = MODELS[model]
    if vehicle.features and not 0 <= vehicle.pca <= vehicle.features:
        what = f"reads {vehicle.pca} terrain features; the dataset has {vehicle.features}"
        raise RunError(what, how="give a smaller --pca")
    dynamics = make(vehicle, seed=seed)
    if dynamics.encoder is not None and not vehicle.features:
        what = f"model '{model}' reads terrain features and the dataset has none"
        raise RunError(what, how="extract with --pca (see fit-pca), or train b")
    return dynamics


class Stretch(NamedTuple):
    """Stretch of a drive that a model was fitted to."""

    drive: str
    first: float  # time of the first row [s]
    last: float  # time of the last row [s]
    rows: str = ""  # digest of the drive's rows, which identifies it under another name; empty if unknown


class _Loss(msgspec.Struct):
    weights: Weights
    scale: dict[str, float]


class _Stated(msgspec.Struct):
    """Entries of model.json that are read (see `save_run`)."""

    model: str
    vehicle: Vehicle
    seed: int
    loss: _Loss
    split: str
    seen: tuple[Stretch, ...]
    weights_sha256: str
    pca: str | None = None
    features: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()

    def refuse_impossible(self) -> None:
        """Raise `ValueError` with the name of an entry whose value is impossible."""
        vehicle, scale, weights = self.vehicle, self.loss.scale, self.loss.weights.in_order()
        for what, good in (
            ("vehicle.mass", 0 < vehicle.mass < math.inf),
            ("vehicle.wheelbase", 0 < vehicle.wheelbase < math.inf),
            ("vehicle.max_steer", 0 <= vehicle.max_steer < math.pi / 2),
            ("vehicle.rear_axle", abs(vehicle.rear_axle) < math.inf),
            ("vehicle.track", 0 <= vehicle.track < math.inf),
            ("vehicle.control", {*vehicle.control} <= {*vehicle.control_columns}),
            ("vehicle.actuators", {*vehicle.actuators} <= {*vehicle.actuator_columns}),
            ("vehicle.features", 0 <= vehicle.features <= _MOST_FEATURES),
            ("vehicle.pca", 0 <= vehicle.pca <= (vehicle.features or _MOST_FEATURES)),
            ("vehicle.codes", 1 <= vehicle.codes <= MOST_CODES),
            ("seed", 0 <= self.seed < 1 << 63),
            ("loss.scale", {*scale} == {*COMPONENTS} and all(0 < value < LARGEST_SCALE for value in scale.values())),
            ("loss.weights", all(0 <= value < LARGEST_SCALE for value in weights) and any(weights)),
        ):
            if not good:
                raise ValueError(f"{what} is impossible")


_SAME: Final = ("model", "seed", "split", "seen", "pca", "features", "assumptions")
"""Entries of model.json that are attributes of a `Run`."""


@dataclass(frozen=True, repr=False)
class Run:
    """Trained model and the data it was trained on.

    Attributes:
        scale: units of the loss (`losses.loss_scale`).
        split: text of the split it was trained on.
        seen: stretches of drives used by training or validation.
        pca: digest of the PCA of the visual features (`Dataset.pca`); None without.
        features: names of the dataset's terrain features.
        assumptions: of the dataset (`offpiste.dataset.assumptions`).
    """

    folder: Path
    dynamics: Dynamics
    model: str
    seed: int
    weights: Weights
    scale: Float[Tensor, " 5"]
    split: str
    seen: tuple[Stretch, ...]
    pca: str | None = None
    features: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Model, folder, size and training data in three lines."""
        parameters = sum(each.numel() for each in self.dynamics.parameters())
        return (
            f"<Run of '{self.model}' in {self.folder}, seed {self.seed}\n"
            f"  {parameters} parameters, {len(self.features)} features of the ground\n"
            f"  split {self.split}, {len(self.assumptions)} assumptions>"
        )


def predict(run: Run, windows: Windows, lookup: Lookup = "recorded") -> Trajectory:
    """Predict states and actuators of windows; positions are relative to each window's start.

        moments = windows.evaluation_indices(5)
        predict(run, windows[moments], "map").state[:, -1, :2]  # position after 5 s [m]

    Args:
        lookup: "map" reads the ground at predicted places, on the map as it was when each window began, as a
            planner does. "recorded" reads it under the wheels' later, recorded places, which no planner knows.
            In a dataset without features, "map" reads the slope of the driven path at the nearest place.

    Raises:
        RunError: the run was trained with other features or channels than the dataset has.
        DatasetError: no window; or the map is asked for and a window does not start with one.
        OffpisteError: unknown lookup.
    """
    refuse_unfit(run, windows.dataset)
    return predict_windows(run.dynamics, windows, lookup)


def load_run(folder: str | Path, *, device: str = "cpu") -> Run:
    """Read a finished run.

    Args:
        folder: written by `offpiste train`, or `pretrained:NAME`.

    Raises:
        RunError: there is no run, or it is unfinished, damaged, or of another version.
    """
    folder = run_folder(folder)
    check_device(device)
    about_file = folder / "model.json"
    if not folder.is_dir():
        how = f"{alike(folder)}give the folder that `offpiste train` wrote"
        raise RunError("no such folder", where=folder, how=how)
    if (folder / "config.json").exists() and not about_file.exists():
        raise RunError("training has not finished", where=folder, how="resume it with `offpiste train --resume`")
    about = load_json(about_file)
    if (schema := about.get("schema", SCHEMA)) != SCHEMA:
        what = f"schema {schema}, this offpiste reads {SCHEMA}: the physics has changed since"
        raise RunError(what, where=about_file, how="train again")
    try:
        stated = msgspec.convert(about, type=_Stated)
        stated.refuse_impossible()
    except (ValueError, msgspec.ValidationError) as error:
        raise RunError(f"cannot be used ({error})", where=about_file, how="train again") from error
    dynamics = build(stated.model, stated.vehicle, seed=stated.seed).to(device)
    tensors, _ = load_tensors(folder / WEIGHTS, stated.weights_sha256)
    load_weights(dynamics, tensors, folder)
    for name, values in tensors.items():
        if not torch.isfinite(values).all():
            raise RunError(f"weights '{name}' are not finite", where=folder, how="train again, or restore the file")
    return Run(
        folder=folder,
        dynamics=dynamics.eval(),
        weights=stated.loss.weights,
        scale=torch.tensor([stated.loss.scale[name] for name in COMPONENTS]),
        **{name: getattr(stated, name) for name in _SAME},
    )


def save_run(
    folder: Path,
    dynamics: Dynamics,
    config: TrainConfig,
    dataset: Dataset,
    scale: Float[Tensor, " 5"],
    best: Mapping[str, BestEpoch] | None = None,
) -> None:
    """Write model.safetensors, and model.json with the best epoch of each stage; the latter marks a run as finished."""
    # model.safetensors is also the file of the last stage: a run that is killed here reads it back when it resumes.
    kept = {stage: asdict(epoch) for stage, epoch in (best or {}).items()}
    save_tensors(folder / WEIGHTS, dynamics.state_dict(), **kept.get("model", {}))
    about = {
        "schema": SCHEMA,
        "model": config.model,
        "weights_sha256": sha256_of(folder / WEIGHTS),
        "seed": config.seed,
        "vehicle": asdict(dynamics.vehicle),
        "loss": {"weights": asdict(config.weights), "scale": dict(zip(COMPONENTS, scale.tolist(), strict=True))},
        "train": asdict(config),
        "dataset": str(dataset.path.resolve()),
        "split": dataset.split.text,
        "seen": seen_stretches(dataset),
        "pca": dataset.pca,
        "features": list(dataset.features),
        "warnings": list(dataset.findings),
        "assumptions": list(assumptions_of(dataset)),
        "kept": kept,
    }
    save_json(folder / "model.json", about)


def model_trained_on(folder: Path, dataset: Path) -> str:
    """Return the model of a finished run if it was trained on a dataset, else ""."""
    try:
        about = load_json(folder / "model.json")
    except RunError:
        return ""
    return str(about.get("model", "")) if about.get("dataset") == str(dataset.resolve()) else ""


def best_epochs(folder: Path) -> dict[str, BestEpoch]:
    """Return the best epoch of each stage of a finished run."""
    return {stage: BestEpoch(**kept) for stage, kept in load_json(folder / "model.json").get("kept", {}).items()}


def check_device(name: str) -> torch.device:
    """Return the device of a name, "cuda" with its number in this thread; raises `RunError` if torch lacks it."""
    try:
        there = torch.zeros(1, device=name)
        there.item()  # fails on devices that cannot compute
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise RunError(f"no device '{name}': {reason}", how="use --device cpu, or install torch for it") from error
    if there.device.type == "cuda":
        torch.backends.cudnn.allow_tf32 = False  # LSTMs would round to 10 bits, and differ from the CPU's
    return there.device


def refuse_seen(run: Run, dataset: Dataset, part: str) -> None:
    """Raise `RunError` if a run was trained or chosen on a part of a dataset."""
    if overlap := overlap_with(run.seen, dataset, part):
        how = "evaluate it on the dataset and split it was trained with, or on another drive"
        raise RunError(f"was trained on {overlap}", where=run.folder, how=how)


def overlap_with(seen: Sequence[Stretch], dataset: Dataset, part: str) -> str:
    """Describe the first overlap of a part of a dataset with stretches that a model was fitted to; "" for none.

    Drives are compared by name, and by their rows, which also find a renamed log.
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
                return f"{count * DT:.0f} s of the {part} part of drive '{named_so}'"
    return ""


def seen_stretches(dataset: Dataset) -> list[Stretch]:
    """Return the stretches of drives in the parts that training and validation read."""
    stretches = []
    for drive in dataset.drives:
        used = np.isin(drive.part, (PARTS.index("train"), PARTS.index("validation")))
        edges = np.flatnonzero(np.diff(used, prepend=False, append=False)).reshape(-1, 2)
        rows, time = _digest_of_rows(drive) if len(edges) else "", drive.rows.time
        stretches += [Stretch(drive.name, float(time[first]), float(time[end - 1]), rows) for first, end in edges]
    return stretches


def _digest_of_rows(drive: StoredDrive) -> str:
    return sha256_of_arrays({name: getattr(drive.rows, name) for name in ("time", "state", "control", "origin")}, {})


def refuse_unfit(run: Run, dataset: Dataset) -> None:
    """Raise `RunError` if a run was trained with other features or channels than a dataset has."""
    for what, how in _misfits(run, dataset):
        raise RunError(what, where=named(run.folder), how=how)


def _misfits(run: Run, dataset: Dataset) -> Iterator[tuple[str, str]]:
    """Yield differences between the features and channels of a run and a dataset, and what to do about them."""
    needed, given = run.dynamics.vehicle, vehicle_of(dataset)
    if run.dynamics.encoder is not None:
        if needed.features != given.features:
            where = named(run.folder)
            pca = where.rpartition("/")[0] if where.startswith(PREFIX) else "and the PCA of its training"
            option = "the same --features" if run.pca is None else f"--pca {pca}"
            what = f"reads {needed.features} terrain features; the dataset has {given.features}"
            yield what, f"use a dataset that was extracted with {option}"
        if None not in (run.pca, dataset.pca) and run.pca != dataset.pca:
            what = f"reads features of PCA {run.pca}; the dataset's were made with PCA {dataset.pca}"
            yield what, "evaluate it on a dataset that was extracted with the PCA of its training"
        if run.features and run.features != dataset.features:
            read, there = (
                ", ".join(names[:4]) + (" …" if len(names) > 4 else "") for names in (run.features, dataset.features)
            )
            what = f"reads the terrain features {read}; the dataset has {there}"
            yield what, "evaluate it on a dataset with the same features"
    for kind in ("control", "actuators"):
        mine, its = getattr(needed, kind), getattr(given, kind)
        if without_optional(mine) != without_optional(its):
            what = f"was trained with {kind} {', '.join(mine) or 'none'}; the dataset has {', '.join(its) or 'none'}"
            yield what, "evaluate it on a dataset whose rig has the same channels"


def differing_vehicle(trained: Vehicle, driven: RigVehicle) -> str | None:
    """Describe how a model's vehicle differs from the one that it drives; None if hardly."""
    apart = [
        f"{name} {mine:.4g} {unit}, not {its:.4g}"
        for name, unit in (("wheelbase", "m"), ("mass", "kg"), ("max_steer", "rad"))
        for mine, its in [(getattr(trained, name), getattr(driven, name))]
        if abs(mine - its) > ALIKE * its
    ]
    return ", ".join(apart) or None
