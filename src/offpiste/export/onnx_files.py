"""Exports as ONNX (extra `onnx`): from images to codes, from the last 0.2 s to the start; checked by onnxruntime."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor, nn

from offpiste.core.errors import OffpisteError, RunError, require
from offpiste.core.shipped import PREFIX, pca_file
from offpiste.dynamics.base import Dynamics
from offpiste.export.c_files import write_readme
from offpiste.export.formats import FORMATS, ImageOptions, write_about
from offpiste.export.onnx_graphs import (
    SIZE,
    ImageToCodes,
    PastToMemory,
    run_graph,
    sample_images,
    write_float16,
    write_graph,
    write_int8,
)
from offpiste.export.parity import parity_case, past_of
from offpiste.logs.measurements import decoded_picture
from offpiste.perception.feature_extractor import FeatureExtractor, load_feature_extractor
from offpiste.training.run import Run

TOLERANCE: Final = 1e-4
"""Largest difference of a code, or of what networks remember, between onnxruntime and torch, both float32."""
MOST: Final = 64
"""Largest number of images that a graph is calibrated with."""


@FORMATS.register("onnx")
def write_onnx(run: Run, folder: Path, images: ImageOptions) -> None:
    """ONNX: `codes.onnx` from rectified images to codes, in float32, float16 and int8, `start.onnx` from the past."""
    for package in ("onnx", "onnxruntime", "onnxscript"):
        require("onnx", package)
    size = images.size or SIZE
    given = None if images.folder is None else read_images(images.folder, size)
    model, pictures = ImageToCodes(extractor_of(run), encoder_of(run), size), sample_images(size)
    codes = checked_graph(run, folder / "codes", model, {"images": pictures}, ("codes",))
    module, inputs = PastToMemory(run.dynamics), past_inputs(run.dynamics)
    start = checked_graph(run, folder / "start", module, inputs, ("hidden", "cell"))
    losses = _write_precisions(folder, pictures if given is None else given, calibrated=given is not None)
    width, height = size
    about = write_about(
        run, folder, image=[height, width, 3], difference=codes, start_difference=start, precisions=losses
    )
    shown = {"difference": f"{codes:.0e}", "start_difference": f"{start:.0e}", "losses": _losses_text(losses)}
    write_readme(folder, "README-onnx.md", about, **shown, height=str(height), width=str(width))


def checked_graph(
    run: Run, stem: Path, module: nn.Module, inputs: dict[str, Tensor], outputs: tuple[str, ...]
) -> float:
    """Write a graph and its parity file (`.onnx`, `-parity.npz`); return its largest difference from torch.

    Raises:
        RunError: onnxruntime computes something else.
    """
    path = stem.with_suffix(".onnx")
    write_graph(module, inputs, outputs, path)
    with torch.no_grad():
        wanted = module(*inputs.values())
    wanted = (wanted,) if isinstance(wanted, Tensor) else wanted
    found = run_graph(path, inputs)
    apart = max(float((a - b).abs().max()) for a, b in zip(found, wanted, strict=True))
    if not apart < TOLERANCE:
        raise RunError(f"onnxruntime differs from torch by {apart:.1e}", where=run.folder, how="report this")
    arrays = inputs | dict(zip(outputs, wanted, strict=True))
    np.savez(stem.with_name(f"{stem.name}-parity.npz"), **{name: value.numpy() for name, value in arrays.items()})
    return apart


def past_inputs(dynamics: Dynamics) -> dict[str, Tensor]:
    """Inputs of the graph of the start, by name: the past of the drives of the parity file."""
    past = past_of(dynamics, parity_case(dynamics, steps=1))
    states = torch.cat((past.state, past.actuators), dim=-1)
    ground = past.terrain
    return {
        "states": states, "controls": past.control, "normals": ground.normal, "known": ground.known,
        "codes": ground.latent,
    }  # fmt: skip


def _write_precisions(folder: Path, images: UInt8[Tensor, "N h w 3"], *, calibrated: bool) -> dict[str, Any]:
    """Write the graphs of lower precision; return the differences of their codes for these images, by file.

    Each has the root mean square `rms` and the `largest` of the differences from the float32 graph, and for comparison
    the standard deviation of the codes among patches, `spread`.
    """
    graph = folder / "codes.onnx"
    write_float16(graph, folder / "codes-float16.onnx")
    if calibrated:
        write_int8(graph, folder / "codes-int8.onnx", images)
    losses = {}
    wanted = _codes(graph, images)
    spread = float(wanted.flatten(0, -2).var(dim=0).mean().sqrt())
    for name in ("codes-float16.onnx", *(["codes-int8.onnx"] if calibrated else [])):
        apart = _codes(folder / name, images) - wanted
        losses[name] = {
            "rms": float(apart.square().mean().sqrt()), "largest": float(apart.abs().max()), "spread": spread
        }  # fmt: skip
    return losses


def _codes(graph: Path, images: UInt8[Tensor, "N h w 3"]) -> Tensor:
    """Codes of images, one at a time."""
    return torch.cat([run_graph(graph, {"images": image})[0] for image in images[:, None].unbind()])


def _losses_text(losses: Mapping[str, Any]) -> str:
    rows = [f"| `{name}` | {of['rms']:.2g} | {of['largest']:.2g} | {of['spread']:.2g} |" for name, of in losses.items()]
    head = "| graph | root mean square | largest | spread of the codes themselves |"
    return "\n".join((head, "|---|---|---|---|", *rows))


def extractor_of(run: Run) -> FeatureExtractor:
    """Backbone and PCA of a run's features.

    Raises:
        RunError: the run has no visual features, or its PCA cannot be found.
    """
    if run.pca is None:
        raise RunError("has no visual features", where=run.folder, how="export a run whose dataset has them, as dc")
    beside = run.folder.parent / "pca.safetensors"
    path = beside if beside.is_file() else pca_file(f"{PREFIX}proving-ground")
    extractor = load_feature_extractor(path)
    if extractor.identity != run.pca:
        what = f"its features come from another PCA than {path}"
        raise RunError(what, where=run.folder, how=f"put that PCA beside the run as {beside}")
    return extractor


def encoder_of(run: Run) -> nn.Module:
    """The encoder of a run.

    Raises:
        RunError: it has none.
    """
    if run.dynamics.encoder is None:
        raise RunError(f"'{run.model}' reads no features", where=run.folder, how="export a model that does, as dc")
    return run.dynamics.encoder


def read_images(folder: Path, size: tuple[int, int]) -> UInt8[Tensor, "N h w 3"]:
    """Rectified RGB pictures of a folder in the order of their names; at most `MOST`, spread evenly.

    Args:
        size: their width and height [px].

    Raises:
        OffpisteError: no picture, or one of another size.
    """
    files = sorted(each for each in folder.glob("*") if each.suffix.lower() in (".png", ".jpg", ".jpeg"))
    if not files:
        raise OffpisteError("no picture (.png, .jpg)", where=folder, how="give a folder with rectified images")
    chosen = np.unique(np.linspace(0, len(files) - 1, min(MOST, len(files))).round().astype(int))
    return torch.from_numpy(np.stack([_picture(files[number], size) for number in chosen]))


def _picture(file: Path, size: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"]:
    width, height = size
    picture = decoded_picture(np.fromfile(file, np.uint8))
    if picture is None or picture.shape[:2] != (height, width):
        found = "no picture" if picture is None else f"a picture of {picture.shape[1]} x {picture.shape[0]}"
        how = f"give rectified pictures of {width} x {height}, or their size: --size WIDTHxHEIGHT"
        raise OffpisteError(found, where=file, how=how)
    return np.ascontiguousarray(picture[..., ::-1])
