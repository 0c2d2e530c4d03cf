"""Exports as ONNX (extra `onnx`): a graph from rectified images to codes of their patches, checked by onnxruntime."""

import logging
import warnings
from pathlib import Path
from typing import Final

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from offpiste.errors import RunError, extra
from offpiste.export.c_files import write_readme
from offpiste.export.formats import FORMATS, write_about
from offpiste.perception.feature_extractor import FeatureExtractor, load_feature_extractor
from offpiste.perception.pca import PrincipalComponents
from offpiste.shipped import PREFIX, pca_file
from offpiste.training.run import Run

SIZE: Final = (360, 640)
"""Height and width of the images that the graph is traced and checked with [px]."""

TOLERANCE: Final = 1e-4
"""Largest difference of a code between onnxruntime and torch, both float32."""

OPSET: Final = 18


class ImageToCodes(nn.Module):
    """Backbone, PCA and encoder of a model as one module.

    Args:
        extractor: the backbone and PCA that the model's features come from.
        encoder: of the model.
    """

    def __init__(self, extractor: FeatureExtractor, encoder: nn.Module) -> None:
        super().__init__()
        self._backbone, self.encoder = extractor.backbone, encoder
        self.mean: Tensor
        self.basis: Tensor
        mean, basis = projection(extractor.pca)
        self.register_buffer("mean", mean)
        self.register_buffer("basis", basis)
        height, width = SIZE
        self._crop = extractor.backbone.grid(width, height).crop

    def forward(self, images: UInt8[Tensor, "B h w 3"]) -> Float[Tensor, "B rows columns E"]:
        """Codes of the patches of rectified images, of the whole patches in their middle."""
        rows, columns = self._crop
        planes = images[:, rows, columns].permute(0, 3, 1, 2).float() / 255
        features = (self._backbone._features(planes) - self.mean) @ self.basis
        patches = features.flatten(0, 2)
        codes: Tensor = self.encoder(patches, torch.ones_like(patches[:, 0], dtype=torch.bool))
        return codes.unflatten(0, features.shape[:3])


def projection(pca: PrincipalComponents) -> tuple[Float[Tensor, " C"], Float[Tensor, "C F"]]:
    """Mean and basis of a PCA, as float32."""
    return torch.as_tensor(pca.mean, dtype=torch.float32), torch.as_tensor(pca.basis, dtype=torch.float32)


@FORMATS.register("onnx")
def write_onnx(run: Run, folder: Path) -> None:
    """ONNX: `codes.onnx`, from rectified images to codes, with backbone and PCA that the run's features come from."""
    with extra("onnx"):
        import onnx  # noqa: F401
        import onnxruntime  # noqa: F401
        import onnxscript  # noqa: F401
    model = ImageToCodes(extractor_of(run), encoder_of(run)).eval()
    path = folder / "codes.onnx"
    images = sample_images()
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it warns of packages that this graph does not need
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            model, (images,), str(path), input_names=["images"], output_names=["codes"], opset_version=OPSET,
            dynamic_shapes={"images": {0: torch.export.Dim("cameras", max=64)}}, dynamo=True, external_data=False,
            verbose=False,
        )  # fmt: skip
        wanted = model(images)
    found = run_onnx(path, images)
    apart = float((found - wanted).abs().max())
    if not apart < TOLERANCE:
        raise RunError(f"onnxruntime's codes differ from torch's by {apart:.1e}", where=run.folder, how="report this")
    np.savez(folder / "parity.npz", images=images.numpy(), codes=wanted.numpy())
    height, width = SIZE
    about = write_about(run, folder, image=[height, width, 3], difference=apart)
    write_readme(folder, "README-onnx.md", about, difference=f"{apart:.0e}", height=str(height), width=str(width))


def extractor_of(run: Run) -> FeatureExtractor:
    """Backbone and PCA of a run's features.

    Raises:
        RunError: the run has no visual features, or its PCA cannot be found.
    """
    if run.pca is None:
        raise RunError("has no visual features", where=run.folder, how="export a run whose dataset has them, as dc")
    beside = run.folder.parent / "pca.safetensors"
    candidates = [beside] if beside.is_file() else [pca_file(f"{PREFIX}proving-ground")]
    extractor = load_feature_extractor(candidates[0])
    if extractor.identity != run.pca:
        what = f"its features come from another PCA than {candidates[0]}"
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


def sample_images() -> UInt8[Tensor, "2 h w 3"]:
    """Two images of blurred noise, always the same."""
    draw = torch.Generator().manual_seed(0)
    height, width = SIZE
    coarse = torch.rand(2, 3, height // 8, width // 8, generator=draw)
    fine = torch.nn.functional.interpolate(coarse, SIZE, mode="bilinear")
    grain = 0.1 * torch.rand(2, 3, height, width, generator=draw)
    return (255 * (0.9 * fine + grain)).to(torch.uint8).permute(0, 2, 3, 1).contiguous()


def run_onnx(path: Path, images: UInt8[Tensor, "B h w 3"]) -> Float[Tensor, "B rows columns E"]:
    """What onnxruntime computes on the CPU."""
    with extra("onnx"):
        import onnxruntime
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    return torch.from_numpy(session.run(["codes"], {"images": images.numpy()})[0])
