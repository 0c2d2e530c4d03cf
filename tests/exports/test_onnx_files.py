"""The exported graph from images to codes, by onnxruntime against torch."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from dynamics.kernels.test_rollout import CHANNELS, example
from offpiste.core.errors import OffpisteError, RunError
from offpiste.dynamics import Hybrid
from offpiste.exports.formats import ImageOptions, export, size_of
from offpiste.exports.onnx_files import (
    PastToMemory,
    checked_graph,
    encoder_of,
    extractor_of,
    past_inputs,
    read_images,
    run_graph,
    sample_images,
)
from offpiste.training.run import load_run

onnx = pytest.importorskip("onnx", reason="the extra onnx is not installed")
pytest.importorskip("onnxscript", reason="the extra onnx is not installed")


def what_tensorrt_refuses(file):
    """Bytes that go into anything but a cast, zero points other than 0, and biases of 32 bits."""
    graph = onnx.load(file).graph
    constants = {each.name: onnx.numpy_helper.to_array(each) for each in graph.initializer}
    found = [node.op_type for node in graph.node if "images" in node.input and node.op_type != "Cast"]
    for node in graph.node:
        if node.op_type in ("QuantizeLinear", "DequantizeLinear") and len(node.input) > 2:
            zero = constants[node.input[2]]
            found += [f"{node.name}: {zero.dtype}"] if zero.any() or zero.dtype != np.int8 else []
    return found


def test_images_become_the_codes_that_the_run_time_computes(tmp_path):
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for number, image in enumerate(sample_images().numpy()):
        cv2.imwrite(str(pictures / f"{number}.png"), image[..., ::-1])
    export("pretrained:proving-ground/dc", tmp_path / "out", "onnx", ImageOptions(pictures))
    run = load_run("pretrained:proving-ground/dc")
    images = sample_images()[[1, 0, 1]]
    found = run_graph(tmp_path / "out" / "codes.onnx", {"images": images})[0]
    features = np.stack([extractor_of(run).extract(image) for image in images.numpy()])
    rows = torch.from_numpy(features).flatten(0, 2)
    with torch.no_grad():
        wanted = encoder_of(run)(rows, torch.ones(len(rows), dtype=torch.bool)).unflatten(0, features.shape[:3])
    torch.testing.assert_close(found, wanted, atol=1e-4, rtol=0)
    kept = np.load(tmp_path / "out" / "codes-parity.npz")
    torch.testing.assert_close(found[1], torch.from_numpy(kept["codes"][0]), atol=1e-4, rtol=0)

    about = json.loads((tmp_path / "out" / "model.json").read_text())
    losses = about["precisions"]
    assert about["image"] == [360, 640, 3]
    for name in ("codes.onnx", *losses):
        assert what_tensorrt_refuses(tmp_path / "out" / name) == []
    assert losses.keys() == {"codes-float16.onnx", "codes-int8.onnx"}
    for name, loss in losses.items():
        again = run_graph(tmp_path / "out" / name, {"images": sample_images()})[0]
        # Products of int8 saturate on processors without VNNI.
        assert 0 < loss["rms"] < (1.0 if "int8" in name else 0.5) * loss["spread"], name
        assert float((again - torch.from_numpy(kept["codes"])).abs().max()) == pytest.approx(loss["largest"], abs=1e-3)
    started = np.load(tmp_path / "out" / "start-parity.npz")
    assert (started["hidden"].shape, started["known"].shape) == ((16, run.dynamics.recurrent_size // 2), (16, 10, 4))


def test_images_of_another_size_have_a_graph_of_their_own(tmp_path):
    run, size = load_run("pretrained:proving-ground/dc"), (203, 121)
    export("pretrained:proving-ground/dc", tmp_path / "out", "onnx", ImageOptions(size=size))
    about = json.loads((tmp_path / "out" / "model.json").read_text())
    assert about["image"] == [121, 203, 3]
    assert "[cameras, 121, 203, 3]" in (tmp_path / "out" / "README.md").read_text()
    images = sample_images(size)
    found = run_graph(tmp_path / "out" / "codes.onnx", {"images": images})[0]
    assert found.shape[1:3] == extractor_of(run).extract(images[0].numpy()).shape[:2]


def test_a_size_is_two_numbers():
    assert size_of("1280x720") == (1280, 720)
    for text in ("1280", "1280x", "0x10", "-5x7", "12.5x3", "1280 x 720", "99999x9"):
        with pytest.raises(OffpisteError, match=r"invalid --size '.*'; give width and height in pixels, 1 to 9999"):
            size_of(text)


@pytest.mark.parametrize("channels", ["gear without throttle", "no actuators"])
def test_what_networks_remember_of_the_past_is_a_graph_for_every_kind_of_vehicle(channels, tmp_path):
    dynamics = example(*CHANNELS[channels], codes=0, kind=Hybrid).float().requires_grad_(False)
    run, inputs = replace(load_run("pretrained:proving-ground/dc"), dynamics=dynamics), past_inputs(dynamics)
    assert checked_graph(run, tmp_path / "start", PastToMemory(dynamics), inputs, ("hidden", "cell")) < 1e-5
    few = {name: value[:3] for name, value in inputs.items()}
    hidden, cell = run_graph(tmp_path / "start.onnx", few)
    wanted = PastToMemory(dynamics)(*few.values())
    torch.testing.assert_close((hidden, cell), wanted, atol=1e-5, rtol=0)
    assert hidden.std() > 0.01


def test_a_graph_that_computes_something_else_and_pictures_of_another_size_are_refused(tmp_path):
    class Drawn(torch.nn.Module):
        def forward(self, x):
            return x + (0 if torch.compiler.is_compiling() else 1)

    run = load_run("pretrained:proving-ground/dc")
    with pytest.raises(RunError, match=r"onnxruntime differs from torch by 1\.0e\+00"):
        checked_graph(run, tmp_path / "x", Drawn(), {"x": torch.ones(2, 3)}, ("y",))
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((4, 5, 3), np.uint8))
    with pytest.raises(OffpisteError, match="an image of 5 x 4"):
        read_images(tmp_path, (640, 360))


def test_runs_without_features_or_with_those_of_another_pca_are_refused():
    with pytest.raises(RunError, match="has no visual features"):
        extractor_of(replace(load_run("pretrained:proving-ground/dc"), pca=None))
    with pytest.raises(RunError, match="its features come from another PCA"):
        extractor_of(replace(load_run("pretrained:proving-ground/dc"), pca="0123456789abcdef"))
    with pytest.raises(RunError, match="reads no features"):
        encoder_of(load_run("pretrained:proving-ground/b"))
