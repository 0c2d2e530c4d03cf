"""Properties of every backbone, on a filterbank and on a small transformer."""

import numpy as np
import pytest
import torch

from offpiste.core.errors import PerceptionError
from offpiste.perception.backbones import Backbone, open_backbone
from offpiste.perception.backbones.filterbank import Filterbank
from offpiste.perception.backbones.vision_transformer import VisionTransformer
from perception.backbones.test_vision_transformer import TINY, made


def tiny_vit() -> VisionTransformer:
    torch.manual_seed(0)
    return VisionTransformer(made("Dinov2", patch_size=14, image_size=70, **TINY), name="tiny")


@pytest.fixture(scope="module", params=["filterbank", "tiny"])
def backbone(request: pytest.FixtureRequest) -> Backbone:
    return Filterbank() if request.param == "filterbank" else tiny_vit()


@pytest.fixture(scope="module")
def images() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, size=(3, 60, 90, 3), dtype=np.uint8)


def test_a_batch_equals_single_images(backbone: Backbone, images: np.ndarray):
    singles = torch.cat([backbone(image[None]) for image in images])
    features = backbone(images)
    assert features.shape == (3, 4, 6, backbone.channels)
    assert features.dtype == torch.float32
    assert torch.allclose(features, singles, atol=1e-5)


@pytest.mark.parametrize(("row", "column"), [(0, 0), (3, 5), (1, 4), (2, 0)])
def test_a_bright_square_lights_up_its_own_cell(backbone: Backbone, row: int, column: int):
    grid = backbone.grid(90, 60)
    x, y = grid.offset
    dark = np.full((1, 60, 90, 3), 60, dtype=np.uint8)
    lit = dark.copy()
    lit[0, y + 14 * row : y + 14 * (row + 1), x + 14 * column : x + 14 * (column + 1)] = 220
    change = (backbone(lit) - backbone(dark)).norm(dim=-1)[0]
    assert divmod(int(change.argmax()), grid.columns) == (row, column)


@pytest.mark.parametrize("value", [np.nan, np.inf, -0.1, 1.1])
def test_pixels_that_are_none_are_refused(backbone: Backbone, value: float):
    image = np.full((1, 30, 30, 3), 0.5, dtype=np.float32)
    image[0, 15, 15, 1] = value
    with pytest.raises(PerceptionError, match=r"not within \[0, 1\]; give uint8, or finite floats"):
        backbone(image)
    with pytest.raises(PerceptionError, match=r"images have type torch.int64; give uint8"):
        backbone(np.zeros((1, 30, 30, 3), dtype=np.int64))


def test_broken_weights_are_named():
    backbone = tiny_vit()
    next(backbone._model.parameters()).data.fill_(torch.inf)
    with pytest.raises(PerceptionError, match=r"^tiny: features are not finite"):
        backbone(np.zeros((1, 28, 28, 3), dtype=np.uint8))


@pytest.mark.parametrize("name", ["dinov2", "no such thing"])
def test_an_unknown_name_is_refused_with_the_names_that_there_are(name: str):
    with pytest.raises(PerceptionError, match=rf"^no backbone '{name}'; give .*filterbank.*, or a vision transformer"):
        open_backbone(name)


@pytest.mark.parametrize("device", ["cuda:99", "tpu"])
def test_a_device_that_is_not_there(device: str):
    with pytest.raises(PerceptionError, match=device):
        open_backbone("filterbank", device=device)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_cuda_gives_what_the_cpu_gives(images: np.ndarray):
    on_cuda = open_backbone("filterbank", device="cuda")(images)
    assert torch.allclose(on_cuda.cpu(), Filterbank()(images), atol=1e-3)
