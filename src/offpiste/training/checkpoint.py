"""Runs on disk: safetensors for numbers, JSON for everything else, no pickle; each file whole or not at all."""

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from offpiste.errors import RunError
from offpiste.files import write_text, write_whole


def save_tensors(path: Path, tensors: dict[str, Tensor], **about: Any) -> None:
    """Write tensors, with a few JSON values in the file's own header."""
    kept = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    header = {"about": json.dumps(about)}
    write_whole(path, lambda partial: save_file(kept, partial, metadata=header))


def load_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read what `save_tensors` wrote.

    Raises:
        RunError: no such file, or a damaged one.
    """
    try:
        with safe_open(path, framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            return tensors, json.loads((file.metadata() or {}).get("about", "{}"))
    except (OSError, SafetensorError, json.JSONDecodeError) as error:
        raise RunError(f"cannot be read: {error}", where=path, how="train again, or restore the file") from error


def save_json(path: Path, content: dict[str, Any]) -> None:
    """Write strict JSON."""
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def load_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        RunError: no such file, or not a JSON object.
    """
    try:
        content = json.loads(path.read_text("utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise RunError("not a run", where=path, how="give the folder that `offpiste train` wrote") from error
    if not isinstance(content, dict):
        raise RunError("not a JSON object", where=path, how="train again, or restore the file")
    return content


def load_weights(module: nn.Module, tensors: dict[str, Tensor], where: Path) -> None:
    """Put weights into a module.

    Raises:
        RunError: they are of another model.
    """
    try:
        module.load_state_dict(tensors)
    except RuntimeError as error:
        reason = str(error).splitlines()[-1].strip()
        raise RunError(
            f"weights do not fit the model: {reason}", where=where, how="use the files of one run"
        ) from error


def adam_tensors(optimiser: torch.optim.Adam, names: dict[Tensor, str]) -> dict[str, Tensor]:
    """Adam's moments as named tensors."""
    return {
        f"adam.{key}.{names[parameter]}": torch.as_tensor(value)
        for parameter, state in optimiser.state.items()
        for key, value in state.items()
    }


def restore_adam(optimiser: torch.optim.Adam, names: dict[Tensor, str], tensors: dict[str, Tensor]) -> None:
    """Put back what `adam_tensors` gave."""
    for parameter, name in names.items():
        state = {}
        for key in ("step", "exp_avg", "exp_avg_sq"):
            tensor = tensors.get(f"adam.{key}.{name}")
            if tensor is not None:
                state[key] = tensor if key == "step" else tensor.to(parameter.device)
        if state:
            optimiser.state[parameter] = state
