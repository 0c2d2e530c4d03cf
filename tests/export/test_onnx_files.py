"""The exported graph from images to codes, by onnxruntime against torch."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from offpiste.errors import RunError
from offpiste.export.formats import export_run
from offpiste.export.onnx_files import encoder_of, extractor_of, run_onnx, sample_images
from offpiste.training.run import pretrained

pytest.importorskip("onnxscript", reason="the extra onnx is not installed")


def test_images_become_the_codes_that_the_run_time_computes(tmp_path):
    export_run("pretrained:proving-ground/dc", tmp_path / "out", "onnx")
    run = pretrained("proving-ground/dc")
    images = sample_images()[[1, 0, 1]]
    found = run_onnx(tmp_path / "out" / "codes.onnx", images)
    features = np.stack([extractor_of(run).extract(image) for image in images.numpy()])
    rows = torch.from_numpy(features).flatten(0, 2)
    with torch.no_grad():
        wanted = encoder_of(run)(rows, torch.ones(len(rows), dtype=torch.bool)).unflatten(0, features.shape[:3])
    torch.testing.assert_close(found, wanted, atol=1e-4, rtol=0)
    kept = np.load(tmp_path / "out" / "parity.npz")
    torch.testing.assert_close(found[1], torch.from_numpy(kept["codes"][0]), atol=1e-4, rtol=0)


def test_runs_without_features_or_with_those_of_another_pca_are_refused():
    with pytest.raises(RunError, match="has no visual features"):
        extractor_of(replace(pretrained("proving-ground/dc"), pca=None))
    with pytest.raises(RunError, match="its features come from another PCA"):
        extractor_of(replace(pretrained("proving-ground/dc"), pca="0123456789abcdef"))
    with pytest.raises(RunError, match="reads no features"):
        encoder_of(pretrained("proving-ground/b"))
