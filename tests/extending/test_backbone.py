"""A backbone of an extension, through the command line."""

from pathlib import Path

from extending.outside import succeeded
from offpiste.perception.pca import load_pca
from sensor_drive import good_drive


def test_a_pca_is_fitted_on_the_features_of_an_added_backbone(tmp_path: Path) -> None:
    folder = good_drive(tmp_path)
    options = ("--rig", folder / "rig.toml", "--out", folder / "p.pca", "--images", "4", "--components", "2")
    more = ("--split", "blocks:1,0,0", "--backbone", "colour-mean")
    said = succeeded("fit-pca", folder / "good.mcap", *options, *more, extension="colour_mean")
    assert "2 components" in said
    pca = load_pca(folder / "p.pca")
    assert pca.backbone == "colour-mean"
    assert pca.mean.shape == (3,)
