"""`offpiste view` on datasets with synthetic features."""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from cli.command import run
from factories import circle_rows, small_rig, stored_dataset
from offpiste.core.conventions import FEATURE_SETS
from offpiste.dataset import store
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.resample import Rows
from offpiste.dataset.wheel_passes import find_passes
from offpiste.mapping.terrain_map import wheel_positions
from offpiste.visualization.coverage import measure_coverage, passes_of
from offpiste.visualization.view import DRIVES_A_PAGE, draw_paths, view_dataset

SETS = len(FEATURE_SETS)


def with_features(rows: Rows) -> Rows:
    """Features that grow by 0.1 with every set, valid in every second cell from 0 m on."""
    xy = rows.state[:, :2].astype(np.float64) + rows.origin
    wheels = wheel_positions(xy, rows.state[:, 2].astype(np.float64), small_rig().wheel_positions())
    passes = find_passes(rows.time, xy, wheels, resolution=0.2)
    count = len(passes.cell)
    valid = np.ones((SETS, count), bool)
    valid[3:, ::2] = False
    features = np.zeros((SETS, count, 2)) + 0.1 * np.arange(SETS)[:, None, None]
    features[0, :, 0] = np.linspace(0, 1, count)
    features[~valid] = np.nan
    known = np.where(valid, 5.0, np.nan).astype(np.float32)
    return replace(rows, cells=Cells(passes.index, features.astype(np.float16), valid, known, known))


def written(folder: Path, rows: list[Rows], features: tuple[str, ...] = ("pca_0", "pca_1")) -> store.Dataset:
    drives = {f"drive-{number}": some for number, some in enumerate(rows)}
    return stored_dataset(folder / "data.zarr", drives, "blocks:0.5,0.25,0.25", features, notes=("a <note>",))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rows = [with_features(circle_rows(1500, seed=seed)) for seed in (0, 1)]
    return written(tmp_path_factory.mktemp("dataset"), rows).path


def test_a_few_wrong_speeds_do_not_stretch_the_colours(tmp_path: Path) -> None:
    rows = circle_rows(1500, speed=5.0)
    state, valid = rows.state.copy(), rows.valid.copy()
    state[700:705, 3] = 20.0  # beside a gap
    state[900:950, 3], valid[900:950] = 30.0, False  # in one
    (drive,) = written(tmp_path, [replace(rows, state=state, valid=valid)], ()).drives
    _, right, bar = draw_paths([drive]).axes
    assert right.collections[0].get_clim() == pytest.approx((5.0, 5.0), abs=0.5)
    assert "speed" in bar.get_ylabel()
    state[:] = np.nan
    (drive,) = written(tmp_path / "b", [replace(rows, state=state, valid=np.zeros_like(valid))], ()).drives
    assert len(draw_paths([drive]).axes) == 3


def test_the_numbers_are_those_of_the_features(dataset: Path) -> None:
    found = measure_coverage(store.open_dataset(dataset))
    assert list(found.by_drive) == ["drive-0", "drive-1"]
    for share in (found.share, *found.by_drive.values()):
        np.testing.assert_allclose(share, (1, 1, 1, *[0.5] * 5), atol=0.01)
    np.testing.assert_allclose(found.quartiles, 5.0)
    # In hindsight the first feature grows evenly from 0 to 1, the second is constant.
    np.testing.assert_allclose(found.apart.neighbours()[:, 0], 0.1 / 0.98, rtol=0.01)
    np.testing.assert_allclose(found.apart_of_total.neighbours()[:, 0], 0.1, rtol=0.01)
    assert np.isnan(found.apart.neighbours()[:, 1]).all()


def test_what_is_in_reach_is_unknown_where_passes_are_others(tmp_path: Path) -> None:
    rows = with_features(circle_rows(1500, seed=0))
    other = replace(rows, cells=replace(rows.cells, index=np.maximum(rows.cells.index - 1, 0)))
    dataset = written(tmp_path, [rows, other])
    assert passes_of(dataset.drives[0], dataset.rig) is not None
    assert passes_of(dataset.drives[1], dataset.rig) is None
    assert np.isnan(measure_coverage(replace(dataset, drives=dataset.drives[1:])).in_reach).all()


def test_the_command_writes_pictures_a_table_and_a_page_that_needs_nothing_else(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("view", dataset, "--out", tmp_path) == 0
    assert {p.name for p in tmp_path.iterdir()} == {"paths.png", "rates.png", "distances.png", "report.html"}
    assert all(cv2.imread(str(p)) is not None for p in tmp_path.glob("*.png"))
    said = capsys.readouterr().out
    assert "valid rate by distance" in said
    assert "0.21" in said  # the paper's at 40 m
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 3
    assert not re.search(r'(?:src|href)="(?!data:|#)', page)
    assert "a &lt;note&gt;" in page


def test_a_dataset_without_visual_features_shows_its_paths(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, [circle_rows(1500, seed=0)], ()).path
    assert run("view", path, "--out", tmp_path / "out", "--rig", "dart") == 0
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"paths.png", "report.html"}
    assert "are ignored" in capsys.readouterr().out
    assert "no visual features" in (tmp_path / "out" / "report.html").read_text()


def test_many_drives_take_several_pictures(dataset: Path, tmp_path: Path) -> None:
    (drive,) = written(tmp_path, [circle_rows(600)], ()).drives
    many = replace(store.open_dataset(dataset), drives=(drive,) * (DRIVES_A_PAGE + 1), features=())
    names = [path.name for path in view_dataset(many, tmp_path / "out")]
    assert names == ["paths-1.png", "paths-2.png", "report.html"]
