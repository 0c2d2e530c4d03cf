"""Files of runs: safetensors and JSON with digests, written whole or not at all; no pickle."""

import json
import re
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import torch
from safetensors import SafetensorError
from safetensors.torch import save
from torch import Tensor, nn

from offpiste.core.checksums import sha256_of, sha256_of_arrays, sha256_of_json
from offpiste.core.errors import RunError
from offpiste.core.files import PARTIAL, remove_partials, write_bytes, write_text
from offpiste.core.limits import open_tensors, parsed, read_small

REMEDY: Final = "train again, or restore the file"

WEIGHTS: Final = "model.safetensors"
"""File with the weights of a run."""

SHARED_STAGES: Final = ("actuators", "bicycle")
"""Stages that all models of a seed can share, as they read no terrain features."""

_FOLD: Final = re.compile(r"fold-(\d+)")
"""Names of the runs of a cross-validation."""


def save_tensors(path: Path, tensors: dict[str, Tensor], **about: Any) -> None:
    """Write tensors, with JSON values and a SHA-256 of both in the file's header."""
    kept = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    # One entry: safetensors writes several in an order that differs from process to process.
    header = {"about": json.dumps({**about, "sha256": sha256_of_tensors(kept, about)})}
    write_bytes(path, save(kept, metadata=header))  # safetensors' own writer hides that a disk is full


def load_tensors(path: Path, sha256: str | None = None) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read tensors and JSON values of `save_tensors`; raises `RunError` for a missing, damaged or other file."""
    try:
        if sha256 is not None:
            _refuse_changed(path, sha256, sha256_of(path))
        with open_tensors(path, "pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            about: dict[str, Any] = parsed((file.metadata() or {}).get("about", "{}"))
            written = about.pop("sha256", None)
    except (OSError, SafetensorError, ValueError, AttributeError) as error:
        raise RunError(f"cannot be read: {error}", where=path, how=REMEDY) from error
    _refuse_changed(path, written, sha256_of_tensors(tensors, about))
    return tensors, about


def save_beside_weights(path: Path, tensors: dict[str, Tensor], **about: Any) -> None:
    """Write tensors into the folder of a run, with the SHA-256 of the weights they belong to."""
    save_tensors(path, tensors, weights_sha256=sha256_of(path.parent / WEIGHTS), **about)


def load_beside_weights(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read a file of `save_beside_weights`; raises `RunError` also if the weights have changed."""
    tensors, about = load_tensors(path)
    if about.pop("weights_sha256", None) != sha256_of(path.parent / WEIGHTS):
        raise RunError("belongs to other weights", where=path, how="delete it and run `offpiste calibrate` again")
    return tensors, about


def sha256_of_tensors(tensors: Mapping[str, Tensor], about: Mapping[str, Any]) -> str:
    """Return the SHA-256 of named tensors, such as a `state_dict`, and of JSON values."""
    return sha256_of_arrays({name: tensor.cpu().numpy() for name, tensor in tensors.items()}, about)


def _refuse_changed(path: Path, written: object, found: str) -> None:
    """Raise `RunError` if the digest stated for a file is missing or differs from its own."""
    if written != found:
        what = "has no checksum" if written is None else "is damaged: its checksum differs"
        raise RunError(what, where=path, how=REMEDY)


def save_json(path: Path, content: dict[str, Any]) -> None:
    """Write strict JSON with a SHA-256 of its content."""
    sealed = {**content, "sha256": sha256_of_json(json.loads(json.dumps(content)))}
    write_text(path, json.dumps(sealed, indent=2, allow_nan=False) + "\n")


def load_json(path: Path) -> dict[str, Any]:
    """Read a JSON object of `save_json`; raises `RunError` for a missing or damaged file."""
    try:
        content = parsed(read_small(path))
    except (OSError, ValueError) as error:
        raise RunError("not a run", where=path, how="give the folder that `offpiste train` wrote") from error
    if not isinstance(content, dict):
        raise RunError("not a JSON object", where=path, how=REMEDY)
    _refuse_changed(path, content.pop("sha256", None), sha256_of_json(content))
    return content


def load_weights(module: nn.Module, tensors: dict[str, Tensor], where: Path) -> None:
    """Load weights into a module; raises `RunError` if they belong to another model."""
    try:
        module.load_state_dict(tensors)
    except RuntimeError as error:
        what = f"weights do not fit the model: {str(error).splitlines()[-1].strip()}"
        raise RunError(what, where=where, how="use the files of one run") from error


def save_checkpoint(
    path: Path, weights: dict[str, dict[str, Tensor]], optimiser: torch.optim.Optimizer, **about: Any
) -> None:
    """Write named weights, as NAME.PARAMETER, and an optimiser's state, as optimiser.NUMBER.KEY."""
    state = optimiser.state_dict()
    named = weights | {f"optimiser.{number}": values for number, values in state["state"].items()}
    tensors = {f"{name}.{key}": value for name, values in named.items() for key, value in values.items()}
    save_tensors(path, tensors, param_groups=state["param_groups"], **about)


def load_checkpoint(
    path: Path, optimiser: torch.optim.Optimizer
) -> tuple[dict[str, dict[str, Tensor]], dict[str, Any]]:
    """Read weights and JSON values of `save_checkpoint`, and restore the state of the optimiser if it is the same."""
    tensors, about = load_tensors(path)
    weights: dict[str, dict[str, Tensor]] = defaultdict(dict)
    state: dict[int, dict[str, Tensor]] = defaultdict(dict)
    for name, value in tensors.items():
        kind, rest = name.split(".", 1)
        if kind == "optimiser":
            number, key = rest.split(".", 1)
            state[int(number)][key] = value
        else:
            weights[kind][rest] = value
    try:
        optimiser.load_state_dict({"state": dict(state), "param_groups": about.pop("param_groups")})
    except (KeyError, ValueError) as error:
        raise RunError(f"does not fit the optimiser: {error}", where=path, how="train again") from error
    return weights, about


def fold_folders(folder: Path) -> list[Path]:
    """Return the runs of a cross-validation in the order of the folds; empty for a single run."""
    numbers = {int(named[1]): path for path in folder.glob("fold-*") if (named := _FOLD.fullmatch(path.name))}
    return [numbers[number] for number in sorted(numbers)]


def refuse_other_folder(folder: Path) -> None:
    """Raise `RunError` if a folder holds more than folds, shared stages and partial files, which are removed."""
    stages = {f"{stage}.safetensors" for stage in SHARED_STAGES}
    for name in (each.name for each in folder.glob("*")):
        if not (name in stages or name.endswith(PARTIAL) or _FOLD.fullmatch(name)):
            raise RunError("holds files that are not of a run", where=folder, how="give another folder as --out")
    remove_partials(folder)
