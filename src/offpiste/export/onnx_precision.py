"""Graphs of codes with less precision, float16 and int8, and what that loses (extra `onnx`)."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from offpiste.core.errors import OffpisteError, extra
from offpiste.export.onnx_graphs import run_graph
from offpiste.logs.measurements import decoded_picture

MOST: Final = 64
"""Images that a graph is calibrated with, at most."""

FOR_TENSORRT: Final = {"ActivationSymmetric": True, "WeightSymmetric": True, "QuantizeBias": False}
"""What TensorRT refuses otherwise: zero points other than 0, and biases of 32 bits."""

QUANTISED: Final = ["Conv", "Gemm", "MatMul"]
"""Operations whose numbers become bytes; the others stay float32."""


@dataclass(frozen=True)
class Loss:
    """What a graph's codes lose against those of the float32 graph.

    Attributes:
        rms: root mean square of the differences.
        largest: largest difference.
        spread: standard deviation of the codes among patches, for comparison.
    """

    rms: float
    largest: float
    spread: float


def loss_of(found: Float[Tensor, "*P E"], wanted: Float[Tensor, "*P E"]) -> Loss:
    """The loss of codes."""
    apart = found - wanted
    spread = wanted.flatten(0, -2).var(dim=0).mean().sqrt()
    return Loss(float(apart.square().mean().sqrt()), float(apart.abs().max()), float(spread))


def write_float16(graph: Path, to: Path) -> None:
    """Write a graph that computes in float16; images and codes stay as they are."""
    with extra("onnx"):
        import onnx
        from onnxruntime.transformers.float16 import convert_float_to_float16
    onnx.save(convert_float_to_float16(onnx.load(graph), keep_io_types=True), to)


def write_int8(graph: Path, to: Path, images: UInt8[Tensor, "N h w 3"]) -> None:
    """Write a graph whose products take bytes (with QDQ nodes, as TensorRT reads them).

    Args:
        images: ranges of all numbers are those that these give.
    """
    with extra("onnx"):
        from onnxruntime.quantization import CalibrationDataReader, quantize_static

    class Images(CalibrationDataReader):  # type: ignore[misc]
        """One image at a time."""

        def __init__(self) -> None:
            self._rest: Iterator[Tensor] = iter(images[:, None].unbind())

        def get_next(self) -> dict[str, Any] | None:
            """The next one."""
            image = next(self._rest, None)
            return None if image is None else {"images": image.numpy()}

    logging.disable(logging.WARNING)  # it recommends a step of its own that these graphs do not need
    try:
        quantize_static(
            graph, to, Images(), per_channel=True, op_types_to_quantize=QUANTISED, extra_options=dict(FOR_TENSORRT)
        )
    finally:
        logging.disable(logging.NOTSET)


def read_images(folder: Path, size: tuple[int, int]) -> UInt8[Tensor, "N h w 3"]:
    """Rectified pictures in a folder, RGB, by name, `MOST` of them spread evenly.

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


def codes_of(graph: Path, images: UInt8[Tensor, "N h w 3"]) -> Float[Tensor, "N rows columns E"]:
    """Codes of images, one at a time."""
    return torch.cat([run_graph(graph, {"images": image})[0] for image in images[:, None].unbind()])
