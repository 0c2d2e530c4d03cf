"""Files of runs: safetensors for numbers, JSON for everything else, no pickle; whole or not at all, with digests."""

import json
import logging
import re
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

logger = logging.getLogger(__name__)

REMEDY: Final = "train again, or restore the file"

WEIGHTS: Final = "model.safetensors"
"""File of a run's weights."""

SHARED_STAGES: Final = ("bicycle",)
"""Stages of training that do not read terrain features: fitted with one model, they serve all of a seed.

The actuators' stage does not either; every training shares that (`offpiste.training.actuator_stage`).
"""

_FOLD: Final = re.compile(r"fold-(\d+)")
"""Names of the runs of a cross-validation."""


def save_tensors(path: Path, tensors: dict[str, Tensor], **about: Any) -> None:
    """Write tensors, with a few JSON values and a SHA-256 of it all in the file's own header."""
    kept = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    # One entry: safetensors writes several in an order that differs from process to process.
    header = {"about": json.dumps({**about, "sha256": sha256_of_tensors(kept, about)})}
    write_bytes(path, save(kept, metadata=header))  # safetensors' own writer hides that a disk is full


def load_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read what `save_tensors` wrote.

    Raises:
        RunError: no such file, or a damaged one.
    """
    try:
        with open_tensors(path, "pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            about: dict[str, Any] = parsed((file.metadata() or {}).get("about", "{}"))
            written = about.pop("sha256", None)
    except (OSError, SafetensorError, ValueError, AttributeError) as error:
        raise RunError(f"cannot be read: {error}", where=path, how=REMEDY) from error
    _refuse_changed(path, written, sha256_of_tensors(tensors, about))
    return tensors, about


def save_beside_weights(path: Path, tensors: dict[str, Tensor], **about: Any) -> None:
    """Write tensors that belong to the weights of a run, into its folder, with the SHA-256 of these."""
    save_tensors(path, tensors, weights_sha256=sha256_of(path.parent / WEIGHTS), **about)


def load_beside_weights(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read what `save_beside_weights` wrote.

    Raises:
        RunError: as `load_tensors`, or the weights are others now.
    """
    tensors, about = load_tensors(path)
    if about.pop("weights_sha256", None) != sha256_of(path.parent / WEIGHTS):
        raise RunError("belongs to other weights", where=path, how="delete it and run `offpiste calibrate` again")
    return tensors, about


def sha256_of_tensors(tensors: Mapping[str, Tensor], about: Mapping[str, Any]) -> str:
    """SHA-256 of named tensors, such as a `state_dict`, and of JSON values about them."""
    return sha256_of_arrays({name: tensor.cpu().numpy() for name, tensor in tensors.items()}, about)


def _refuse_changed(path: Path, written: object, found: str) -> None:
    if written is None:
        logger.warning(f"{path}: has no checksum, since an older offpiste wrote it: damage would not be noticed")
    elif written != found:
        raise RunError("is damaged: its checksum differs", where=path, how=REMEDY)


def save_json(path: Path, content: dict[str, Any]) -> None:
    """Write strict JSON, with a SHA-256 of what it says."""
    sealed = {**content, "sha256": sha256_of_json(json.loads(json.dumps(content)))}
    write_text(path, json.dumps(sealed, indent=2, allow_nan=False) + "\n")


def load_json(path: Path) -> dict[str, Any]:
    """Read what `save_json` wrote.

    Raises:
        RunError: no such file, not a JSON object, or a damaged one.
    """
    try:
        content = parsed(read_small(path))
    except (OSError, ValueError) as error:
        raise RunError("not a run", where=path, how="give the folder that `offpiste train` wrote") from error
    if not isinstance(content, dict):
        raise RunError("not a JSON object", where=path, how=REMEDY)
    _refuse_changed(path, content.pop("sha256", None), sha256_of_json(content))
    return content


def refuse_other_file(path: Path, digest: str | None) -> None:
    """Raise if a file of a run is not the one that its JSON names.

    Args:
        digest: its SHA-256; None where an older offpiste kept none.

    Raises:
        RunError: it is missing, or has another one.
    """
    try:
        found = sha256_of(path)
    except OSError as error:
        raise RunError(f"cannot be read: {error}", where=path, how=REMEDY) from error
    _refuse_changed(path, digest, found)


def load_weights(module: nn.Module, tensors: dict[str, Tensor], where: Path) -> None:
    """Put weights into a module.

    Raises:
        RunError: they belong to another model.
    """
    try:
        module.load_state_dict(tensors)
    except RuntimeError as error:
        reason = str(error).splitlines()[-1].strip()
        raise RunError(
            f"weights do not fit the model: {reason}", where=where, how="use the files of one run"
        ) from error


def save_checkpoint(
    path: Path, weights: dict[str, dict[str, Tensor]], optimiser: torch.optim.Optimizer, **about: Any
) -> None:
    """Write weights, and the optimiser's `state_dict`: its tensors beside the weights, the rest as JSON."""
    state = optimiser.state_dict()
    tensors = {f"{name}.{key}": value for name, result in weights.items() for key, value in result.items()}
    tensors |= {f"optimiser.{n}.{key}": value for n, result in state["state"].items() for key, value in result.items()}
    save_tensors(path, tensors, param_groups=state["param_groups"], **about)


def load_checkpoint(
    path: Path, optimiser: torch.optim.Optimizer
) -> tuple[dict[str, dict[str, Tensor]], dict[str, Any]]:
    """Read what `save_checkpoint` wrote: weights and the values beside them; the optimiser gets its state back.

    Raises:
        RunError: no such file, a damaged one, or of another optimiser.
    """
    tensors, about = load_tensors(path)
    weights: dict[str, dict[str, Tensor]] = {}
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        head, rest = name.split(".", 1)
        if head == "optimiser":
            number, key = rest.split(".", 1)
            state.setdefault(int(number), {})[key] = value
        else:
            weights.setdefault(head, {})[rest] = value
    try:
        optimiser.load_state_dict({"state": state, "param_groups": about.pop("param_groups")})
    except (KeyError, ValueError) as error:
        raise RunError(f"does not fit the optimiser: {error}", where=path, how="train again") from error
    return weights, about


def fold_folders(folder: Path) -> list[Path]:
    """The runs of a cross-validation, in the order of the folds; empty if the folder is a single run."""
    numbers = {int(named[1]): path for path in folder.glob("fold-*") if (named := _FOLD.fullmatch(path.name))}
    return [numbers[number] for number in sorted(numbers)]


def refuse_other_folder(folder: Path) -> None:
    """Check that a folder that holds no run may become one: it is not there, or holds nothing but folds or stages.

    Raises:
        RunError: it holds something else, which a run's files might overwrite.
    """
    if not folder.exists():
        return
    if any(not _of_training(each.name) for each in folder.iterdir()):
        raise RunError("is a folder of something else than a run", where=folder, how="give another one as --out")
    remove_partials(folder)


def _of_training(name: str) -> bool:
    """Whether a file or folder of this name is there before a run is: a fold, a stage of another run, what was cut."""
    stages = {f"{stage}.safetensors" for stage in SHARED_STAGES}
    return name in stages or name.endswith(PARTIAL) or _FOLD.fullmatch(name) is not None
