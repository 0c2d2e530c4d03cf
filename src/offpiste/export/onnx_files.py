"""Exports as ONNX (extra `onnx`): from images to codes, from the last 0.2 s to the start; checked by onnxruntime."""

from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor, nn

from offpiste.core.errors import RunError, extra
from offpiste.core.shipped import PREFIX, pca_file
from offpiste.dynamics.base import Dynamics
from offpiste.export.c_files import write_readme
from offpiste.export.formats import FORMATS, ImageOptions, write_about
from offpiste.export.onnx_graphs import SIZE, ImageToCodes, PastToMemory, run_graph, sample_images, write_graph
from offpiste.export.onnx_precision import codes_of, loss_of, read_images, write_float16, write_int8
from offpiste.export.parity import parity_case, past_of
from offpiste.perception.feature_extractor import FeatureExtractor, load_feature_extractor
from offpiste.training.run import Run

TOLERANCE: Final = 1e-4
"""Largest difference of a code, or of what networks remember, between onnxruntime and torch, both float32."""


@FORMATS.register("onnx")
def write_onnx(run: Run, folder: Path, images: ImageOptions) -> None:
    """ONNX: `codes.onnx` from rectified images to codes, in float32, float16 and int8, `start.onnx` from the past."""
    with extra("onnx"):
        import onnx  # noqa: F401
        import onnxruntime  # noqa: F401
        import onnxscript  # noqa: F401
    size = images.size or SIZE
    given = None if images.folder is None else read_images(images.folder, size)
    model, pictures = ImageToCodes(extractor_of(run), encoder_of(run), size), sample_images(size)
    codes = checked_graph(run, folder / "codes", model, {"images": pictures}, ("codes",))
    start = _write_start(run, folder)
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
    """Write a graph and its parity file (`.onnx`, `-parity.npz`); its largest difference from torch.

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


def _write_start(run: Run, folder: Path) -> float:
    module, inputs = PastToMemory(run.dynamics), past_inputs(run.dynamics)
    return checked_graph(run, folder / "start", module, inputs, ("hidden", "cell"))


def _write_precisions(folder: Path, images: UInt8[Tensor, "N h w 3"], *, calibrated: bool) -> dict[str, Any]:
    """Write the graphs of less precision; what each loses on these images."""
    graph = folder / "codes.onnx"
    write_float16(graph, folder / "codes-float16.onnx")
    names = ["codes-float16.onnx"]
    if calibrated:
        write_int8(graph, folder / "codes-int8.onnx", images)
        names.append("codes-int8.onnx")
    wanted = codes_of(graph, images)
    return {name: asdict(loss_of(codes_of(folder / name, images), wanted)) for name in names}


def _losses_text(losses: dict[str, Any]) -> str:
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
