"""The streaming PCA against NumPy's of all patches at once; cutting, saving, and bases that do not belong."""

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from offpiste.core.errors import PerceptionError
from offpiste.perception.backbones.filterbank import Filterbank
from offpiste.perception.patch_grid import PatchGrid
from offpiste.perception.pca import Moments, PrincipalComponents, fit, load_pca, save_pca

BACKBONE = Filterbank()


def correlated(count: int, channels: int, seed: int = 0) -> np.ndarray:
    """Features with spreads that fall by channel, mixed, and far from the origin."""
    generator = np.random.default_rng(seed)
    mixing = np.linalg.qr(generator.normal(size=(channels, channels)))[0]
    spread = 0.7 ** np.arange(channels)
    return generator.normal(size=(count, channels)) * spread @ mixing + 50.0


def fitted(count: int = 500, channels: int = 12, components: int = 6) -> PrincipalComponents:
    return fit(Moments.of(correlated(count, channels)), BACKBONE, components=components, images=3, drives=["a.mcap"])


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


def test_components_are_uncorrelated_with_the_stated_variance():
    features = correlated(400, 10)
    pca = fit(Moments.of(features), BACKBONE, components=4)
    components = pca.project(torch.from_numpy(features.reshape(4, 10, 10, 10)))
    assert components.shape == (4, 10, 10, 4)
    covariance = np.cov(components.reshape(-1, 4).numpy().T)
    assert np.allclose(covariance, np.diag(pca.variance), atol=1e-4)
    assert np.allclose(components.mean(dim=(0, 1, 2)), 0.0, atol=1e-4)


def test_only_ground_counts():
    features = torch.from_numpy(correlated(2 * 3 * 4, 5)).reshape(2, 3, 4, 5).float()
    grid = PatchGrid(40, 30, 10)
    ground = np.stack([grid.hit(np.array([[5.0, 25.0], [35.0, 5.0]])), grid.hit(np.empty((0, 2)))])
    spoiled = torch.where(torch.from_numpy(ground)[..., None], features, torch.nan)
    moments = Moments.none(5).add(spoiled, ground)
    assert moments.count == 2
    assert np.allclose(moments.mean, (features[0, 2, 0] + features[0, 0, 3]) / 2)


def test_signs_are_fixed():
    features = correlated(300, 8)
    basis = fit(Moments.of(features), BACKBONE, components=5).basis
    assert (basis[np.abs(basis).argmax(axis=0), np.arange(5)] > 0).all()
    shuffled = fit(Moments.of(features[::-1].copy()), BACKBONE, components=5).basis
    assert np.allclose(basis, shuffled, atol=1e-6)


def test_cut_keeps_the_first():
    pca = fitted()
    features = torch.from_numpy(correlated(20, 12)).float()
    assert pca.cut(2).components == 2
    assert torch.allclose(pca.cut(2).project(features), pca.project(features)[:, :2])
    assert pca.cut(2).identity != pca.identity
    for wrong in (0, 7):
        with pytest.raises(PerceptionError, match=f"{wrong} components, but the PCA has 6"):
            pca.cut(wrong)


def test_fewer_patches_or_channels_than_components():
    assert fit(Moments.of(correlated(5, 12)), BACKBONE).components == 4
    assert fit(Moments.of(correlated(500, 12)), BACKBONE).components == 12


def test_constant_channels_make_no_components():
    features = correlated(200, 6)
    features[:, [1, 4]] = 3.0
    pca = fit(Moments.of(features.astype(np.float32)), BACKBONE)
    assert pca.components == 4
    assert np.abs(pca.basis[[1, 4]]).max() < 1e-6
    assert torch.isfinite(pca.project(torch.from_numpy(features).float())).all()


def test_a_large_mean_costs_no_precision():
    features = correlated(400, 6)
    near, far = fit(Moments.of(features), BACKBONE), fit(Moments.of(features + 1e5), BACKBONE)
    assert np.allclose(near.variance, far.variance, rtol=1e-6)


@pytest.mark.parametrize("count", [0, 1])
def test_no_ground(count: int):
    with pytest.raises(PerceptionError, match=f"^{count} patches of ground in the images: too few for a PCA"):
        fit(Moments.of(np.ones((count, 4))), BACKBONE)


def test_ground_without_variance():
    with pytest.raises(PerceptionError, match="all patches of ground are alike"):
        fit(Moments.of(np.ones((50, 4))), BACKBONE)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_features_that_are_not_finite(value: float):
    features = correlated(30, 4)
    features[7, 2] = value
    with pytest.raises(PerceptionError, match="features to be reduced are not finite"):
        Moments.of(features)


def test_features_of_another_length():
    with pytest.raises(PerceptionError, match="features of 5 channels for a PCA of 12"):
        fitted().project(torch.zeros(3, 5))


def test_saved_and_read_again(tmp_path: Path):
    pca = fitted(channels=BACKBONE.channels)
    save_pca(tmp_path / "pca.safetensors", pca)
    again = load_pca(tmp_path / "pca.safetensors", BACKBONE)
    for name in ("mean", "basis", "variance"):
        assert np.array_equal(getattr(again, name), getattr(pca, name))
    assert again.identity == pca.identity
    assert again.total_variance == pca.total_variance
    assert again.fitted_on == {"patches": 500, "images": 3, "drives": ["a.mcap"]}
    save_pca(tmp_path / "cut.safetensors", again.cut(2))
    assert load_pca(tmp_path / "cut.safetensors").components == 2


def test_another_backbone_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    save_pca(tmp_path / "pca.safetensors", fitted(channels=BACKBONE.channels))
    monkeypatch.setattr(Filterbank, "settings", lambda _: {"kind": "other"})
    other = Filterbank()
    with pytest.raises(PerceptionError) as caught:
        load_pca(tmp_path / "pca.safetensors", other)
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
