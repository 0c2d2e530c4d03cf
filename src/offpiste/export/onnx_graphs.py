"""Parts of a model as modules for ONNX graphs; graphs are written, reduced in precision, and run (extra `onnx`)."""

import logging
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor, nn

from offpiste.core.state import History, Terrain
from offpiste.dynamics.base import Dynamics
from offpiste.perception.feature_extractor import FeatureExtractor

SIZE: Final = (640, 360)
"""Width and height of the images of the graph of codes, where nothing else is said [px]."""

OPSET: Final = 18

LARGEST_BATCH: Final = 64

TENSORRT: Final = {"ActivationSymmetric": True, "WeightSymmetric": True, "QuantizeBias": False}
"""TensorRT refuses zero points other than 0, and biases of 32 bits."""

QUANTISED: Final = ["Conv", "Gemm", "MatMul"]
"""Operations whose numbers become bytes; the others stay float32."""


class ImageToCodes(nn.Module):
    """Backbone, PCA and encoder of a model as one module.

    Args:
        extractor: the backbone and PCA that the model's features come from.
        encoder: of the model.
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
        """Codes of the patches of rectified images, of the whole patches in their middle."""
        rows, columns = self._crop
        # TensorRT takes bytes only where the first operation makes floats of them.
        planes = images.float().permute(0, 3, 1, 2)[:, :, rows, columns] / 255
        features = (self._backbone.features(planes) - self.mean) @ self.basis
        patches = features.flatten(0, 2)
        codes: Tensor = self.encoder(patches, torch.ones_like(patches[:, 0], dtype=torch.bool))
        return codes.unflatten(0, features.shape[:3])


class PastToMemory(nn.Module):
    """What the networks of a model remember of the last 0.2 s (`Dynamics.start`), as one module."""

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
        """Hidden units and cells, from states and actuators, and what was given, of rows before the start."""
        past = History(states[..., :6], states[..., 6:], controls, Terrain(normals, known, codes))
        started = self.dynamics.start(past, states[:, -1, :6], states[:, -1, 6:])
        return started.hidden, started.cell


def write_graph(module: nn.Module, inputs: Mapping[str, Tensor], outputs: tuple[str, ...], path: Path) -> None:
    """Write a module as an ONNX file; the first axis of all inputs is the batch, whose size stays free."""
    batch = torch.export.Dim("batch", max=LARGEST_BATCH)
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it warns of packages that these graphs do not need
        torch.onnx.export(
            module.eval(), tuple(inputs.values()), path, input_names=list(inputs), output_names=list(outputs),
            opset_version=OPSET, dynamic_shapes=tuple({0: batch} for _ in inputs), external_data=False, verbose=False,
        )  # fmt: skip


def run_graph(path: Path, inputs: Mapping[str, Tensor]) -> list[Tensor]:
    """Outputs of a graph by onnxruntime on the CPU; inputs that it does not read are left out."""
    import onnxruntime

    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    read = {each.name for each in session.get_inputs()}
    given = {name: value.numpy() for name, value in inputs.items() if name in read}
    return [torch.from_numpy(output) for output in session.run(None, given)]


def write_float16(graph: Path, to: Path) -> None:
    """Write a graph that computes in float16; images and codes stay as they are."""
    import onnx
    from onnxruntime.transformers.float16 import convert_float_to_float16

    onnx.save(convert_float_to_float16(onnx.load(graph), keep_io_types=True), to)


def write_int8(graph: Path, to: Path, images: UInt8[Tensor, "N h w 3"]) -> None:
    """Write a graph whose products take bytes (with QDQ nodes, as TensorRT reads them).

    Args:
        images: these define the ranges of all numbers.
    """
    from onnxruntime.quantization import CalibrationDataReader, quantize_static

    class Images(CalibrationDataReader):  # type: ignore[misc]
        """One image at a time."""

        def __init__(self) -> None:
            self._rest = iter(images[:, None].unbind())

        def get_next(self) -> dict[str, Any] | None:
            """Return the next image; None at the end."""
            image = next(self._rest, None)
            return None if image is None else {"images": image.numpy()}

    logging.disable(logging.WARNING)  # it recommends a step of its own that these graphs do not need
    try:
        quantize_static(graph, to, Images(), per_channel=True, op_types_to_quantize=QUANTISED, extra_options=TENSORRT)
    finally:
        logging.disable(logging.NOTSET)


def sample_images(size: tuple[int, int] = SIZE) -> UInt8[Tensor, "2 h w 3"]:
    """Two images of blurred noise, deterministic for a width and height [px]."""
    draw = torch.Generator().manual_seed(0)
    width, height = size
    coarse = torch.rand(2, 3, max(height // 8, 1), max(width // 8, 1), generator=draw)
    fine = torch.nn.functional.interpolate(coarse, (height, width), mode="bilinear")
    grain = 0.1 * torch.rand(2, 3, height, width, generator=draw)
    return (255 * (0.9 * fine + grain)).to(torch.uint8).permute(0, 2, 3, 1).contiguous()
