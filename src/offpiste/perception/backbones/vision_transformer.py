"""DINOv2 and related models through transformers: patch features of the last layer after its LayerNorm.

Oquab et al., "DINOv2: Learning Robust Visual Features without Supervision", 2023.
"""

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import torch
from jaxtyping import Float
from safetensors import SafetensorError
from torch import Tensor

from offpiste.core.errors import PerceptionError, did_you_mean, extra
from offpiste.core.limits import parsed, read_small
from offpiste.perception.backbones import DINOV2_SMALL, Backbone

if TYPE_CHECKING:
    from transformers import PreTrainedModel

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)
"""Mean and standard deviation of RGB in [0, 1] over ImageNet, the default normalisation."""

FAMILY = ("dinov2", "dinov2_with_registers", "dinov3_vit")
"""`model_type` of supported models, with tokens in the order class, registers, patches by row."""

_NEEDED = ("config.json", "model.safetensors")
_FILES = (*_NEEDED, "preprocessor_config.json")
_OTHERWISE = "use the backbone filterbank, which needs no weights"
_FOLDER = f"give a folder with {' and '.join(_NEEDED)}, or {_OTHERWISE}"


@final
class VisionTransformer(Backbone):
    """Vision transformer of `FAMILY`, with the mean and standard deviation of RGB in [0, 1] that it expects."""

    def __init__(
        self,
        model: "PreTrainedModel",
        *,
        name: str,
        mean: tuple[float, ...] = IMAGENET_MEAN,
        std: tuple[float, ...] = IMAGENET_STD,
        device: torch.device | None = None,
    ) -> None:
        config: Any = model.config
        if config.model_type not in FAMILY:
            how = f"use one of {', '.join(FAMILY)}"
            raise PerceptionError(f"a model of type {config.model_type!r}", where=name, how=how)
        self.name, self.patch, self.channels = name, int(config.patch_size), int(config.hidden_size)
        self._weights = weights_hash(model)
        self._mean, self._std = mean, std
        self._device = device or torch.device("cpu")
        module: torch.nn.Module = model
        self._model = module.to(self._device).eval().requires_grad_(False)

    @property
    def device(self) -> torch.device:
        """Device of the computation."""
        return self._device

    def settings(self) -> dict[str, Any]:
        """Return architecture, normalisation and a hash of the weights."""
        config: Any = self._model.config
        return {
            "kind": config.model_type,
            "patch": self.patch,
            "channels": self.channels,
            "layers": config.num_hidden_layers,
            "heads": config.num_attention_heads,
            "mean": list(self._mean),
            "std": list(self._std),
            "weights": self._weights,
        }

    def _features(self, images: Float[Tensor, "B 3 h w"]) -> Float[Tensor, "B rows columns C"]:
        mean, std = (images.new_tensor(values).view(1, 3, 1, 1) for values in (self._mean, self._std))
        tokens = self._model(pixel_values=(images - mean) / std).last_hidden_state
        rows, columns = images.shape[2] // self.patch, images.shape[3] // self.patch
        return tokens[:, -rows * columns :].reshape(len(images), rows, columns, self.channels)


def weights_hash(model: torch.nn.Module) -> str:
    """Return a hash of a model's parameters without their names, which differ between versions of transformers."""
    parameters = (parameter.detach().float().cpu().contiguous() for parameter in model.parameters())
    digests = sorted(hashlib.sha256(parameter.numpy().tobytes()).hexdigest() for parameter in parameters)
    return hashlib.sha256("".join(digests).encode()).hexdigest()[:16]


def load_vision_transformer(name: str, *, device: torch.device) -> VisionTransformer:
    """Load a model from safetensors in a folder, the hub's cache or the hub, in this order.

    Raises `MissingExtra` without transformers, `PerceptionError` if weights are missing or invalid.
    """
    with extra("vit", otherwise=_OTHERWISE):
        from transformers import AutoModel
        from transformers.utils import logging
    folder = Path(name) if Path(name).exists() else _hub_folder(name)
    if not folder.is_dir():
        raise PerceptionError("is a file, not a folder of safetensors", where=folder, how=_FOLDER)
    if missing := _missing(folder):
        raise PerceptionError(f"lacks {' and '.join(missing)}", where=folder, how=_FOLDER)
    mean, std = _normalisation(folder)
    bars = logging.is_progress_bar_enabled()
    logging.disable_progress_bar()  # type: ignore[no-untyped-call]
    try:
        model, result = AutoModel.from_pretrained(
            folder, local_files_only=True, use_safetensors=True, dtype=torch.float32, output_loading_info=True
        )
    except (OSError, ValueError, RuntimeError, SafetensorError) as error:
        what = f"cannot read a vision transformer: {_first_line(error)}"
        raise PerceptionError(what, where=folder, how=_FOLDER) from error
    finally:
        if bars:
            logging.enable_progress_bar()  # type: ignore[no-untyped-call]
    if lacking := sorted(result["missing_keys"]) + sorted(str(key) for key in result["mismatched_keys"]):
        what = f"weights lack {lacking[0]} and {len(lacking) - 1} others"
        raise PerceptionError(what, where=folder, how="download them again")
    return VisionTransformer(model, name=name, mean=mean, std=std, device=device)


def _missing(folder: Path) -> list[str]:
    return [needed for needed in _NEEDED if not (folder / needed).is_file()]


def _hub_folder(name: str) -> Path:
    """Return the cached folder of a hub's model, downloading it if needed."""
    from huggingface_hub import HfApi, snapshot_download
    from huggingface_hub.errors import HFValidationError

    try:
        folder = Path(snapshot_download(name, allow_patterns=list(_FILES), local_files_only=True))
        if not _missing(folder):
            return folder
    except HFValidationError as error:
        alike = did_you_mean(Path(name).name, [beside.name for beside in Path(name).parent.glob("*/")])
        raise PerceptionError(
            "is neither a folder nor the name of a model on the Hugging Face hub",
            where=name,
            how=f"{alike}give a name like {DINOV2_SMALL}, or {_FOLDER}",
        ) from error
    except OSError:
        pass
    try:
        # A query comes first: without a network, a download retries for half a minute.
        HfApi().model_info(name, timeout=10)
        return Path(snapshot_download(name, allow_patterns=list(_FILES)))
    except Exception as error:
        # The remedy is the same for every error of the hub's client.
        fetch = f"`hf download {name} {' '.join(_FILES)} --local-dir FOLDER`"
        raise PerceptionError(
            f"weights are not in the hub's cache and could not be downloaded ({_first_line(error)})",
            where=name,
            how=f"run {fetch} on a computer with a network and give FOLDER instead, or {_OTHERWISE}",
        ) from error


def _normalisation(folder: Path) -> tuple[tuple[float, ...], ...]:
    """Return the mean and standard deviation of RGB of a model's preprocessor; ImageNet's by default."""
    path = folder / "preprocessor_config.json"
    if not path.is_file():
        return IMAGENET_MEAN, IMAGENET_STD
    try:
        content = parsed(read_small(path))
        result = tuple(tuple(float(value) for value in content[key]) for key in ("image_mean", "image_std"))
        if [len(values) for values in result] != [3, 3]:
            raise ValueError("not three values")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        what = "no image_mean and image_std of three values"
        raise PerceptionError(what, where=path, how="download the file again") from error
    return result


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return (lines[0] if lines else type(error).__name__).rstrip(".")
