"""Export of models as ONNX graphs, checked against torch by onnxruntime (extra `onnx`)."""

import logging
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor, nn

from offpiste.core.errors import OffpisteError, RunError, require
from offpiste.core.shipped import PREFIX, pca_file
from offpiste.core.state import History, Terrain
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.kernels.model_state import hidden_and_cells
from offpiste.exports.c_files import write_readme
from offpiste.exports.formats import FORMATS, ImageOptions, write_about
from offpiste.exports.parity import parity_case, past_of
from offpiste.logs.measurements import decoded_picture
from offpiste.perception.feature_extractor import FeatureExtractor, load_feature_extractor
from offpiste.training.run import Run

SIZE: Final = (640, 360)
"""Default width and height of images [px]."""

TOLERANCE: Final = 1e-4
"""Largest accepted difference between onnxruntime and torch."""

CALIBRATION_IMAGES: Final = 64
"""Maximum number of calibration images."""

OPSET: Final = 18
LARGEST_BATCH: Final = 64

TENSORRT: Final = {"ActivationSymmetric": True, "WeightSymmetric": True, "QuantizeBias": False}
"""Quantisation options: TensorRT accepts neither non-zero zero points nor 32-bit biases."""

QUANTISED: Final = ["Conv", "Gemm", "MatMul"]
"""Quantised operators; all others stay float32."""


@FORMATS.register("onnx")
def write_onnx(run: Run, folder: Path, images: ImageOptions) -> None:
    """Write `codes*.onnx` (rectified images to codes; float32, float16, int8) and `start.onnx` (past to memory)."""
    for package in ("onnx", "onnxruntime", "onnxscript"):
        require("onnx", package)
    size = images.size or SIZE
    given = None if images.folder is None else read_images(images.folder, size)
    model, samples = ImageToCodes(extractor_of(run), encoder_of(run), size), sample_images(size)
    codes = checked_graph(run, folder / "codes", model, {"images": samples}, ("codes",))
    module, inputs = PastToMemory(run.dynamics), past_inputs(run.dynamics)
    start = checked_graph(run, folder / "start", module, inputs, ("hidden", "cell"))
    losses = _write_precisions(folder, samples if given is None else given, calibrated=given is not None)
    width, height = size
    about = write_about(
        run, folder, image=[height, width, 3], difference=codes, start_difference=start, precisions=losses
    )
    shown = {"difference": f"{codes:.0e}", "start_difference": f"{start:.0e}", "losses": _losses_text(losses)}
    write_readme(folder, "README-onnx.md", about, **shown, height=str(height), width=str(width))


class ImageToCodes(nn.Module):
    """Backbone, PCA and encoder of a model.

    Args:
        size: width and height of the images [px].
    """

    def __init__(self, extractor: FeatureExtractor, encoder: nn.Module, size: tuple[int, int] = SIZE) -> None:
        super().__init__()
        self._backbone, self.encoder = extractor.backbone, encoder
        self.mean: Tensor
        self.basis: Tensor
        pca = extractor.pca
        self.register_buffer("mean", torch.as_tensor(pca.mean, dtype=torch.float32))
        self.register_buffer("basis", torch.as_tensor(pca.basis, dtype=torch.float32))
        self._crop = extractor.backbone.grid(*size).crop

    def forward(self, images: UInt8[Tensor, "B h w 3"]) -> Float[Tensor, "B rows columns E"]:
        """Return the codes of all whole patches of rectified images."""
        rows, columns = self._crop
        # TensorRT accepts uint8 input only if the first operator is a cast.
        planes = images.float().permute(0, 3, 1, 2)[:, :, rows, columns] / 255
        features = (self._backbone.features(planes) - self.mean) @ self.basis
        patches = features.flatten(0, 2)
        codes: Tensor = self.encoder(patches, torch.ones_like(patches[:, 0], dtype=torch.bool))
        return codes.unflatten(0, features.shape[:3])


class PastToMemory(nn.Module):
    """Recurrent state of a model after the last 0.2 s (`Dynamics.start`)."""

    def __init__(self, dynamics: Dynamics) -> None:
        super().__init__()
        self.dynamics = dynamics

    def forward(
        self,
        states: Float[Tensor, "B H 10"],
        controls: Float[Tensor, "B H U"],
        normals: Float[Tensor, "B H 4 3"],
        known: Bool[Tensor, "B H 4"],
        codes: Float[Tensor, "B H 4 E"],
    ) -> tuple[Float[Tensor, "B S"], Float[Tensor, "B S"]]:
        """Return hidden units and cells; states include the actuators."""
        past = History(states[..., :6], states[..., 6:], controls, Terrain(normals, known, codes))
        started = self.dynamics.start(past, states[:, -1, :6], states[:, -1, 6:])
        return hidden_and_cells(started.recurrent)


def checked_graph(
    run: Run, stem: Path, module: nn.Module, inputs: dict[str, Tensor], outputs: tuple[str, ...]
) -> float:
    """Write a graph and its parity file (`.onnx`, `-parity.npz`); return its largest difference from torch.

    The first axis of all inputs is the batch, whose size is free.

    Raises:
        RunError: the difference exceeds `TOLERANCE`.
    """
    path, batch = stem.with_suffix(".onnx"), torch.export.Dim("batch", max=LARGEST_BATCH)
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # warnings about packages that are not needed here
        torch.onnx.export(
            module.eval(), tuple(inputs.values()), path, input_names=list(inputs), output_names=list(outputs),
            opset_version=OPSET, dynamic_shapes=tuple({0: batch} for _ in inputs), external_data=False, verbose=False,
        )  # fmt: skip
        wanted = module(*inputs.values())
    wanted = (wanted,) if isinstance(wanted, Tensor) else wanted
    found = run_graph(path, inputs)
    difference = max(float((a - b).abs().max()) for a, b in zip(found, wanted, strict=True))
    if not difference < TOLERANCE:
        raise RunError(f"onnxruntime differs from torch by {difference:.1e}", where=run.folder, how="report this")
    arrays = inputs | dict(zip(outputs, wanted, strict=True))
    np.savez(stem.with_name(f"{stem.name}-parity.npz"), **{name: value.numpy() for name, value in arrays.items()})
    return difference


def run_graph(path: Path, inputs: Mapping[str, Tensor]) -> list[Tensor]:
    """Return the outputs of a graph by onnxruntime on the CPU; inputs unknown to the graph are ignored."""
    import onnxruntime

    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    read = {each.name for each in session.get_inputs()}
    given = {name: value.numpy() for name, value in inputs.items() if name in read}
    return [torch.from_numpy(output) for output in session.run(None, given)]


def past_inputs(dynamics: Dynamics) -> dict[str, Tensor]:
    """Return the inputs of the start graph by name: the past of the drives in the parity file."""
    past = past_of(dynamics, parity_case(dynamics, steps=1))
    states, ground = torch.cat((past.state, past.actuators), dim=-1), past.terrain
    return {
        "states": states, "controls": past.control, "normals": ground.normal, "known": ground.known,
        "codes": ground.latent,
    }  # fmt: skip


def _write_precisions(folder: Path, images: UInt8[Tensor, "N h w 3"], *, calibrated: bool) -> dict[str, Any]:
    """Write the graphs of lower precision, and return the errors of their codes by file.

    Each has the root mean square (`rms`) and the `largest` difference from the float32 graph, and for comparison the
    standard deviation of the codes among patches (`spread`).
    """
    import onnx
    from onnxruntime.transformers.float16 import convert_float_to_float16

    graph, names = folder / "codes.onnx", ["codes-float16.onnx"]
    onnx.save(convert_float_to_float16(onnx.load(graph), keep_io_types=True), folder / names[0])
    if calibrated:
        names.append("codes-int8.onnx")
        _write_int8(graph, folder / names[1], images)
    losses, wanted = {}, _codes(graph, images)
    spread = float(wanted.flatten(0, -2).var(dim=0).mean().sqrt())
    for name in names:
        error = _codes(folder / name, images) - wanted
        losses[name] = {
            "rms": float(error.square().mean().sqrt()), "largest": float(error.abs().max()), "spread": spread
        }  # fmt: skip
    return losses


def _write_int8(graph: Path, to: Path, images: UInt8[Tensor, "N h w 3"]) -> None:
    """Write an int8 graph with QDQ nodes, whose ranges are calibrated on images."""
    from onnxruntime.quantization import CalibrationDataReader, quantize_static

    class Images(CalibrationDataReader):  # type: ignore[misc]
        """One image at a time."""

        def __init__(self) -> None:
            self._rest = iter(images[:, None].unbind())

        def get_next(self) -> dict[str, Any] | None:
            """Return the next image; None at the end."""
            image = next(self._rest, None)
            return None if image is None else {"images": image.numpy()}

    logging.disable(logging.WARNING)  # it recommends a preprocessing step that these graphs do not need
    try:
        quantize_static(graph, to, Images(), per_channel=True, op_types_to_quantize=QUANTISED, extra_options=TENSORRT)
    finally:
        logging.disable(logging.NOTSET)


def _codes(graph: Path, images: UInt8[Tensor, "N h w 3"]) -> Tensor:
    """Return the codes of images, computed one image at a time."""
    return torch.cat([run_graph(graph, {"images": image})[0] for image in images[:, None].unbind()])


def _losses_text(losses: Mapping[str, Any]) -> str:
    rows = [f"| `{name}` | {of['rms']:.2g} | {of['largest']:.2g} | {of['spread']:.2g} |" for name, of in losses.items()]
    head = "| graph | root mean square | largest | spread of the codes themselves |"
    return "\n".join((head, "|---|---|---|---|", *rows))


def extractor_of(run: Run) -> FeatureExtractor:
    """Return the backbone and PCA of a run.

    Raises:
        RunError: the run has no visual features, or its PCA is missing.
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
    """Return the feature encoder of a run.

    Raises:
        RunError: the model has none.
    """
    if run.dynamics.encoder is None:
        raise RunError(f"'{run.model}' reads no features", where=run.folder, how="export a model that does, as dc")
    return run.dynamics.encoder


def read_images(folder: Path, size: tuple[int, int]) -> UInt8[Tensor, "N h w 3"]:
    """Read up to `CALIBRATION_IMAGES` rectified RGB images of a folder, spread evenly over their sorted names.

    Raises:
        OffpisteError: no image, or an image of another size.
    """
    files = sorted(each for each in folder.glob("*") if each.suffix.lower() in (".png", ".jpg", ".jpeg"))
    if not files:
        raise OffpisteError("has no images (.png, .jpg)", where=folder, how="give a folder with rectified images")
    chosen = np.unique(np.linspace(0, len(files) - 1, min(CALIBRATION_IMAGES, len(files))).round().astype(int))
    return torch.from_numpy(np.stack([_picture(files[number], size) for number in chosen]))


def _picture(file: Path, size: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"]:
    width, height = size
    picture = decoded_picture(np.fromfile(file, np.uint8))
    if picture is None or picture.shape[:2] != (height, width):
        found = "not an image" if picture is None else f"is an image of {picture.shape[1]} x {picture.shape[0]}"
        how = f"give rectified images of {width} x {height}, or their size: --size WIDTHxHEIGHT"
        raise OffpisteError(found, where=file, how=how)
    return np.asarray(picture)


def sample_images(size: tuple[int, int] = SIZE) -> UInt8[Tensor, "2 h w 3"]:
    """Return two images of blurred noise; deterministic for a width and height [px]."""
    draw = torch.Generator().manual_seed(0)
    width, height = size
    coarse = torch.rand(2, 3, max(height // 8, 1), max(width // 8, 1), generator=draw)
    fine = torch.nn.functional.interpolate(coarse, (height, width), mode="bilinear")
    grain = 0.1 * torch.rand(2, 3, height, width, generator=draw)
    return (255 * (0.9 * fine + grain)).to(torch.uint8).permute(0, 2, 3, 1).contiguous()
