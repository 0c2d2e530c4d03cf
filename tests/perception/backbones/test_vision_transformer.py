"""Vision transformers against their own output, and sources of weights."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from offpiste.core.errors import PerceptionError
from offpiste.perception.backbones import open_backbone
from offpiste.perception.backbones.vision_transformer import VisionTransformer

SMALL = {"hidden_size": 384, "num_attention_heads": 6, "image_size": 518, "patch_size": 14}
"""config.json of facebook/dinov2-small without the number of layers."""
TINY = {"hidden_size": 32, "num_attention_heads": 2, "num_hidden_layers": 2}


def made(family: str, **settings: object) -> torch.nn.Module:
    """A model of transformers, which takes seconds to import."""
    import transformers

    return getattr(transformers, f"{family}Model")(getattr(transformers, f"{family}Config")(**settings))


def lively(model: torch.nn.Module) -> torch.nn.Module:
    """Random values where initialisation puts zeros or ones, so that no part can be lost unseen."""
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            if parameter.ndim == 1 or "token" in name or "position" in name:
                parameter.add_(0.1 * torch.randn_like(parameter))
    return model.eval()


@pytest.fixture(scope="module")
def model() -> torch.nn.Module:
    """ViT-S/14 of two layers with random weights."""
    torch.manual_seed(0)
    return lively(made("Dinov2", num_hidden_layers=2, **SMALL))


@pytest.fixture(scope="module")
def images() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, size=(2, 73, 101, 3), dtype=np.uint8)


def normalised(images: np.ndarray) -> Tensor:
    """ImageNet's constants as torchvision's and DINOv2's documentation print them."""
    scaled = (images / 255 - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225]
    return torch.from_numpy(scaled).permute(0, 3, 1, 2).float()


def test_agrees_with_transformers_for_the_same_weights(model: torch.nn.Module, images: np.ndarray):
    with torch.no_grad():
        tokens = model(normalised(images[:, 1:71, 1:99])).last_hidden_state  # the centred crop
    wanted = tokens[:, 1:].reshape(2, 5, 7, 384)
    transformer = VisionTransformer(model, name="random")
    assert torch.allclose(transformer(images), wanted, atol=1e-4)
    assert VisionTransformer(model, name="a", mean=(0.5, 0.5, 0.5)).fingerprint != transformer.fingerprint


@pytest.mark.parametrize(
    ("family", "settings", "patch"),
    [
        ("Dinov2WithRegisters", {"image_size": 70}, 14),
        ("DINOv3ViT", {"image_size": 64, "intermediate_size": 64}, 16),
    ],
)
def test_registers_are_no_patches(family: str, settings: dict, patch: int):
    torch.manual_seed(0)
    model = lively(made(family, patch_size=patch, num_register_tokens=4, **TINY, **settings))
    image = np.random.default_rng(0).integers(0, 256, size=(1, 2 * patch, 3 * patch, 3), dtype=np.uint8)
    features = VisionTransformer(model, name="family")(image)
    with torch.no_grad():
        tokens = model(normalised(image)).last_hidden_state
    assert tokens.shape[1] == 1 + 4 + 6
    assert torch.allclose(features[0, 1, 2], tokens[0, 10], atol=1e-5)
    assert torch.allclose(features[0, 0, 0], tokens[0, 5], atol=1e-5)


def test_other_families_are_refused():
    with pytest.raises(PerceptionError, match=r"^google: a model of type 'vit'; use one of dinov2, "):
        VisionTransformer(made("ViT", image_size=32, intermediate_size=32, **TINY), name="google")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A small model as a user would save it."""
    torch.manual_seed(1)
    lively(made("Dinov2", patch_size=14, image_size=70, **TINY)).save_pretrained(tmp_path / "tiny")
    return tmp_path / "tiny"


def test_a_folder_gives_back_what_was_saved_with_its_own_normalisation(folder: Path):
    from transformers import Dinov2Model

    image = np.random.default_rng(0).integers(0, 256, size=(1, 42, 56, 3), dtype=np.uint8)
    opened, saved = open_backbone(str(folder)), VisionTransformer(Dinov2Model.from_pretrained(folder), name="same")
    assert opened.fingerprint == saved.fingerprint
    assert torch.equal(opened(image), saved(image))
    constants = {"image_mean": [0.43, 0.411, 0.296], "image_std": [0.213, 0.156, 0.143]}
    (folder / "preprocessor_config.json").write_text(json.dumps(constants))
    settings = open_backbone(str(folder)).settings()
    assert (settings["mean"], settings["std"]) == (constants["image_mean"], constants["image_std"])


def only_a_pickle(folder: Path) -> None:
    (folder / "model.safetensors").unlink()
    torch.save({"never": torch.zeros(1)}, folder / "pytorch_model.bin")


def deeper(folder: Path) -> None:
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps({**config, "num_hidden_layers": 3}))


@pytest.mark.parametrize(
    ("file", "content", "said"),
    [
        ("preprocessor_config.json", b"{", r"preprocessor_config.json: no image_mean"),
        ("preprocessor_config.json", b'{"image_mean": [0.5], "image_std": [1]}', r"preprocessor_config.json: no image"),
        ("model.safetensors", b"", "cannot read a vision transformer"),
        ("model.safetensors", b"\xff" * 64, "cannot read a vision transformer"),
        (None, only_a_pickle, r"lacks model\.safetensors; give a folder"),
        (None, deeper, r"weights lack encoder.layer.2.* others; download them again"),
    ],
)
def test_unusable_weights_end_in_one_line(folder: Path, file: str | None, content: object, said: str):
    if file is None:
        content(folder)
    else:
        (folder / file).write_bytes(content)
    with pytest.raises(PerceptionError, match=said):
        open_backbone(str(folder))


def test_names_that_are_no_weights(folder: Path, tmp_path: Path):
    (tmp_path / "w.pth").write_bytes(b"PK")
    (tmp_path / "empty").mkdir()
    for name, said in (
        ("no/such thing", r"^no/such thing: is neither a folder nor the name of a model"),
        (f"{folder.parent}/{folder.name[:-1]}", f"neither a folder .*did you mean '{folder.name}'"),
        (str(tmp_path / "w.pth"), r"w\.pth: is a file, not a folder.*with config\.json"),
        (str(tmp_path / "empty"), r"lacks config\.json and model\.safetensors; give"),
    ):
        with pytest.raises(PerceptionError, match=said):
            open_backbone(name)


def test_no_network_and_no_cache(monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object, **__: object) -> None:
        raise OSError("Name or service not known")

    monkeypatch.setattr("huggingface_hub.snapshot_download", refuse)
    monkeypatch.setattr("huggingface_hub.HfApi.model_info", refuse)
    with pytest.raises(PerceptionError) as caught:
        open_backbone()
    message = str(caught.value)
    assert message.startswith("facebook/dinov2-small: weights are not in the hub's cache and could not be downloaded")
    assert "hf download facebook/dinov2-small" in message
    assert message.endswith("or use the backbone filterbank, which needs no weights")
