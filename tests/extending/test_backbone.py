"""A backbone of an extension, through the command line."""

from pathlib import Path

import pytest

from extending.outside import offpiste
from offpiste.perception.pca import load_pca
from sensor_drive import good_drive


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return good_drive(tmp_path_factory.mktemp("backbone"))


def fit_pca(folder: Path, backbone: str, extension: str):
    options = ("--rig", folder / "rig.toml", "--out", folder / "p.pca", "--images", "4", "--components", "2")
    more = ("--split", "blocks:1,0,0", "--backbone", backbone)
    return offpiste("fit-pca", folder / "good.mcap", *options, *more, extension=extension)


def test_a_pca_is_fitted_on_the_features_of_an_added_backbone(folder: Path) -> None:
    done = fit_pca(folder, "colour-mean", "colour_mean")
    assert done.returncode == 0, done.stderr
    assert "2 components" in done.stdout
    pca = load_pca(folder / "p.pca")
    assert pca.backbone == "colour-mean"
    assert pca.mean.shape == (3,)


def test_an_unknown_backbone_is_refused_with_those_that_there_are(folder: Path) -> None:
    done = fit_pca(folder, "colour-median", "colour_mean")
    assert done.returncode == 1
    expected = "offpiste: no backbone 'colour-median'; give colour-mean, filterbank, or a vision transformer"
    assert done.stderr.startswith(expected)
    assert done.stderr.count("\n") == 1
