"""Streaming PCA against NumPy's of all patches at once, and its file."""

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from offpiste.core.errors import PerceptionError
from offpiste.perception.backbones.filterbank import Filterbank
from offpiste.perception.pca import Moments, PrincipalComponents, fit, load_pca, save_pca

BACKBONE = Filterbank()


def correlated(count: int, channels: int, seed: int = 0) -> np.ndarray:
    """Features with spreads that fall by channel, mixed, and far from the origin."""
    generator = np.random.default_rng(seed)
    mixing = np.linalg.qr(generator.normal(size=(channels, channels)))[0]
    spread = 0.7 ** np.arange(channels)
    return generator.normal(size=(count, channels)) * spread @ mixing + 50.0


def fitted() -> PrincipalComponents:
    moments = Moments.of(correlated(500, BACKBONE.channels))
    return fit(moments, BACKBONE, components=6, images=3, drives=["a.mcap"])


@given(cuts=st.lists(st.integers(0, 300), max_size=6), seed=st.integers(0, 9))
def test_any_batches_equal_all_at_once(cuts: list[int], seed: int):
    features = correlated(300, 7, seed)
    moments = Moments.none(7)
    for part in np.split(features, sorted(cuts)):
        moments = moments + Moments.of(part)
    assert moments.count == 300
    assert np.allclose(moments.mean, features.mean(axis=0), rtol=1e-13)
    assert np.allclose(moments.scatter / 299, np.cov(features.T), rtol=1e-10, atol=1e-12)


def test_equals_the_singular_vectors_of_all_patches():
    features = correlated(400, 10)
    pca = fit(Moments.of(features[:77]) + Moments.of(features[77:]), BACKBONE, components=4)
    _, singular, rows = np.linalg.svd(features - features.mean(axis=0), full_matrices=False)
    assert np.allclose(pca.variance, singular[:4] ** 2 / 399, rtol=1e-5)
    assert np.allclose(np.abs((pca.basis.T * rows[:4]).sum(axis=1)), 1.0, atol=1e-6)
    assert pca.total_variance == pytest.approx(np.var(features, axis=0, ddof=1).sum())
    components = pca.project(torch.from_numpy(features.reshape(4, 10, 10, 10)))
    assert components.shape == (4, 10, 10, 4)
    assert np.allclose(np.cov(components.reshape(-1, 4).numpy().T), np.diag(pca.variance), atol=1e-4)


def test_directions_without_variance_make_no_components():
    assert fit(Moments.of(correlated(5, 12)), BACKBONE).components == 4
    features = correlated(200, 6)
    features[:, [1, 4]] = 3.0
    pca = fit(Moments.of(features.astype(np.float32)), BACKBONE)
    assert pca.components == 4
    assert np.abs(pca.basis[[1, 4]]).max() < 1e-6
    assert torch.isfinite(pca.project(torch.from_numpy(features).float())).all()


def test_ground_that_is_too_little_flat_or_not_finite_is_refused():
    for count in (0, 1):
        with pytest.raises(PerceptionError, match=f"^{count} ground patches in the images, too few for a PCA"):
            fit(Moments.of(np.ones((count, 4))), BACKBONE)
    with pytest.raises(PerceptionError, match="all ground patches are equal"):
        fit(Moments.of(np.ones((50, 4))), BACKBONE)
    for value in (np.nan, np.inf):
        features = correlated(30, 4)
        features[7, 2] = value
        with pytest.raises(PerceptionError, match="features to be reduced are not finite"):
            Moments.of(features)


def test_saved_and_read_again(tmp_path: Path):
    pca = fitted()
    save_pca(tmp_path / "pca.safetensors", pca)
    again = load_pca(tmp_path / "pca.safetensors")
    for name in ("mean", "basis", "variance"):
        assert np.array_equal(getattr(again, name), getattr(pca, name))
    assert again.identity == pca.identity
    assert again.total_variance == pca.total_variance
    assert again.fitted_on == {"patches": 500, "images": 3, "drives": ["a.mcap"]}


def test_another_backbone_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    save_pca(tmp_path / "pca.safetensors", fitted())
    monkeypatch.setattr(Filterbank, "settings", lambda _: {"kind": "other"})
    other = Filterbank()
    with pytest.raises(PerceptionError) as caught:
        load_pca(tmp_path / "pca.safetensors").check(other, where="pca.safetensors")
    message = str(caught.value)
    assert f"the backbone in use is filterbank ({other.fingerprint})" in message
    assert "fitted on features of filterbank (" in message
    assert "pca.safetensors" in message
    assert "\n" not in message


@pytest.mark.parametrize("content", [None, b"", b"no safetensors at all", "another"])
def test_what_is_no_pca(tmp_path: Path, content: bytes | str | None):
    path = tmp_path / "pca.safetensors"
    if content == "another":
        from safetensors.numpy import save_file

        save_file({"mean": np.zeros(3)}, path)
    elif isinstance(content, bytes):
        path.write_bytes(content)
    with pytest.raises(PerceptionError, match=r"pca.safetensors: not a PCA of offpiste"):
        load_pca(path)
