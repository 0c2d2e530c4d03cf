"""A trained model on disk: what it is, what it was trained on, and its weights."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.checksums import sha256_of
from offpiste.core.errors import RunError
from offpiste.core.shipped import PREFIX, alike, run_folder
from offpiste.core.state import Trajectory
from offpiste.dataset.assumptions import assumptions_of
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import Dynamics, Vehicle
from offpiste.training.build import build
from offpiste.training.checkpoint import (
    WEIGHTS,
    load_json,
    load_tensors,
    load_weights,
    refuse_other_file,
    save_json,
    save_tensors,
)
from offpiste.training.config import MOST_CODES, TrainConfig, Weights
from offpiste.training.fitness import Stretch, refuse_unfit, seen_stretches
from offpiste.training.kept_epoch import KeptEpoch
from offpiste.training.losses import COMPONENTS
from offpiste.training.prediction import Lookup, predict_windows

SCHEMA = 2
"""Version of a run: of what its files say, and of the physics that its weights belong to."""

_MOST_FEATURES: Final = 1 << 16
"""More terrain features than any backbone has."""
_LARGEST: Final = 1e30
"""Units and weights of the loss are less: float32 holds their product with an error."""


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
    pca: str | None = None
    features: tuple[str, ...] = ()
    weights_sha256: str | None = None
    assumptions: tuple[str, ...] = ()


@dataclass(frozen=True)
class Run:
    """A trained model and what it was trained on.

    Attributes:
        scale: the loss's units (`losses.loss_scale`).
        split: text of the split it was trained under.
        seen: stretches of drives that training or validation used.
        pca: of the visual features (`Dataset.pca`); None without, and of runs older than this entry.
        features: names of the dataset's terrain features; none without, and of runs older than this entry.
        assumptions: behind the dataset (`offpiste.dataset.assumptions`).
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

    def predict(self, windows: Windows, lookup: Lookup = "recorded") -> Trajectory:
        """Predicted states and actuators of windows; positions are relative to each window's start.

            moments = windows.evaluation_indices(5)
            run.predict(windows[moments], "map").state[:, -1, :2]  # where the vehicle is after 5 s [m]

        Args:
            lookup: "map" reads the ground at predicted places, on the map as it was when each window began: what a
                planner can do. "recorded" reads it under the wheels' later, recorded places, which no planner knows.
                In a dataset without features, "map" reads the slope of the driven path at the nearest place.

        Raises:
            RunError: the run was trained with other features or channels than the dataset has.
            DatasetError: no window; or the map is asked for and a window does not start with one.
            OffpisteError: no such lookup.
        """
        refuse_unfit(self, windows.dataset)
        return predict_windows(self.dynamics, windows, lookup)


def load_run(folder: str | Path, *, device: str = "cpu") -> Run:
    """Read a finished run.

    Args:
        folder: that `offpiste train` wrote, or `pretrained:NAME`.

    Raises:
        RunError: no run there, not finished, damaged, or of another version.
    """
    folder = run_folder(folder)
    check_device(device)
    if not folder.is_dir():
        raise RunError(
            "no such folder", where=folder, how=f"{alike(folder)}give the folder that `offpiste train` wrote"
        )
    if (folder / "config.json").exists() and not (folder / "model.json").exists():
        raise RunError("training has not finished", where=folder, how="resume it with `offpiste train --resume`")
    about = load_json(folder / "model.json")
    if about.get("schema", SCHEMA) != SCHEMA:
        raise RunError(
            f"schema {about['schema']}, this offpiste reads {SCHEMA}: the physics has changed since",
            where=folder / "model.json",
            how="train again",
        )
    try:
        stated = msgspec.convert(about, type=_Stated)
        _refuse_impossible(stated)
    except (ValueError, msgspec.ValidationError) as error:
        raise RunError(f"cannot be used ({error})", where=folder / "model.json", how="train again") from error
    dynamics = build(stated.model, stated.vehicle, seed=stated.seed).to(device)
    scale = torch.tensor([stated.loss.scale[name] for name in COMPONENTS])
    refuse_other_file(folder / WEIGHTS, stated.weights_sha256)
    tensors = load_tensors(folder / WEIGHTS)[0]
    load_weights(dynamics, tensors, folder)
    for name, values in tensors.items():
        if not torch.isfinite(values).all():
            raise RunError(f"weights '{name}' are not finite", where=folder, how="train again, or restore the file")
    return Run(
        folder,
        dynamics.eval(),
        stated.model,
        stated.seed,
        stated.loss.weights,
        scale,
        stated.split,
        stated.seen,
        stated.pca,
        stated.features,
        stated.assumptions,
    )


def pretrained(name: str, *, device: str = "cpu") -> Run:
    """A model that ships with offpiste, by its name, with or without "pretrained:": `pretrained("proving-ground/dc")`.

    Raises:
        RunError: no model of that name ships.
    """
    return load_run(f"{PREFIX}{name.removeprefix(PREFIX)}", device=device)


def _refuse_impossible(stated: _Stated) -> None:
    """Raise unless the numbers and names of a model.json are possible, which types alone cannot say.

    Raises:
        ValueError: which entry.
    """
    vehicle, scale, weights = stated.vehicle, stated.loss.scale, stated.loss.weights.in_order()
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
        ("seed", 0 <= stated.seed < 1 << 63),
        ("loss.scale", {*scale} == {*COMPONENTS} and all(0 < value < _LARGEST for value in scale.values())),
        ("loss.weights", all(0 <= value < _LARGEST for value in weights) and any(weights)),
    ):
        if not good:
            raise ValueError(f"{what} is impossible")


def save_run(
    folder: Path,
    dynamics: Dynamics,
    config: TrainConfig,
    dataset: Dataset,
    scale: Float[Tensor, " 5"],
    kept: Mapping[str, KeptEpoch] | None = None,
) -> None:
    """Write model.safetensors and model.json, with the epoch that each stage kept; the latter finishes a run."""
    # The file of the last stage: a run that is killed here reads it back when it resumes.
    last = kept["model"].about() if kept and "model" in kept else {}
    save_tensors(folder / WEIGHTS, dynamics.state_dict(), **last)
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
        "kept": {stage: asdict(epoch) for stage, epoch in (kept or {}).items()},
    }
    save_json(folder / "model.json", about)


def model_trained_on(folder: Path, dataset: Path) -> str:
    """The model of a finished run, where it was trained on a dataset; "" else."""
    try:
        about = load_json(folder / "model.json")
    except RunError:
        return ""
    return str(about.get("model", "")) if about.get("dataset") == str(dataset.resolve()) else ""


def kept_epochs(folder: Path) -> dict[str, KeptEpoch]:
    """The epoch that each stage of a finished run kept, by stage."""
    return {stage: KeptEpoch(**kept) for stage, kept in load_json(folder / "model.json").get("kept", {}).items()}


def check_device(name: str) -> torch.device:
    """The device of a name, with the number that "cuda" stands for in this thread: other threads may have another.

    Raises:
        RunError: no such device, or torch was built without it.
    """
    try:
        there = torch.zeros(1, device=name)
        there.item()  # which tells devices that compute from those that only have a name
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise RunError(f"no device '{name}': {reason}", how="use --device cpu, or install torch for it") from error
    device = there.device
    if device.type == "cuda":
        torch.backends.cudnn.allow_tf32 = False  # LSTMs would round to 10 bits, and differ from the CPU's
    return device
