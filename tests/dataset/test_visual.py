"""From a recorded drive with camera and LiDAR to visual features by distance, against the simulator's truth."""

from pathlib import Path

import numpy as np
import pytest
import torch

from offpiste.cli import main
from offpiste.conventions import FEATURE_SETS
from offpiste.dataset.make import make_dataset
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.errors import DatasetError, LogError
from offpiste.logs.truth import read_truth_map
from offpiste.mapping.terrain import wheel_places
from offpiste.rig import load_rig
from offpiste.simulation.simulate import DriveSettings, simulate
from offpiste.simulation.surface import read_grid
from offpiste.simulation.world import WorldSettings


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("visual")
    world = WorldSettings("mojave", seed=3, size=120.0, resolution=0.5)
    simulate(DriveSettings(world, 12.0, seed=1, sensors="light"), folder / "drive.mcap")
    options = {"--rig": "proving_ground", "--backbone": "filterbank", "--images": "6", "--components": "12"}
    options |= {"--split": "blocks:1,0,0", "--out": str(folder / "pca.safetensors")}
    with pytest.raises(SystemExit) as exit_:
        main(["fit-pca", str(folder / "drive.mcap"), *(word for pair in options.items() for word in pair)])
    assert not exit_.value.code
    return folder


@pytest.fixture(scope="module")
def dataset(folder: Path) -> Dataset:
    said: list[str] = []
    made = make_dataset(
        [folder / "drive.mcap"],
        load_rig("proving_ground"),
        folder / "data.zarr",
        split="blocks:1,0,0",
        pca=folder / "pca.safetensors",
        tell=said.append,
    )
    assert "valid by distance: hindsight" in said[0]
    return made


def test_every_set_is_there_and_its_views_were_taken_from_where_it_says(dataset: Dataset) -> None:
    cells = dataset.drives[0].rows.cells
    assert cells.features.shape[0] == len(FEATURE_SETS)
    assert dataset.features == tuple(f"pca_{n}" for n in range(12))
    rates = dict(zip(FEATURE_SETS, cells.valid.mean(axis=1), strict=True))
    assert rates["hindsight"] > 0.8
    assert rates["10"] > rates["30"]
    for name in ("10", "20"):
        number = FEATURE_SETS.index(name)
        seen = cells.distance[number][cells.valid[number]]
        # The map keeps the closest observation, so a view is never from much nearer than the vehicle has been.
        assert np.median(seen) == pytest.approx(float(name), abs=5.0)
    assert (np.isfinite(cells.features).all(axis=2) == cells.valid).all()


def test_elevation_and_normals_are_those_of_the_world(dataset: Dataset, folder: Path) -> None:
    rows, rig = dataset.drives[0].rows, dataset.rig
    truth = read_truth_map(folder / "drive.mcap")
    places = wheel_places(rows.state[:, :2] + rows.origin, rows.state[:, 2].astype(float), rig.wheel_positions())
    under = rows.cells.index
    here = rows.cells.elevation[0][under]
    known = (under >= 0) & np.isfinite(here)
    wanted = read_grid(truth.layers["elevation"], truth.origin, truth.resolution, places[known])
    assert known.mean() > 0.8
    assert np.median(np.abs(here[known] - wanted)) < 0.06
    rise_y, rise_x = np.gradient(truth.layers["elevation"], truth.resolution)
    slope = read_grid(np.stack((rise_x, rise_y), axis=-1), truth.origin, truth.resolution, places[known])
    normal = rows.normal[0][known]
    assert np.median(np.abs(-normal[:, :2] / normal[:, 2:] - slope)) < 0.06


def test_windows_give_the_features_to_models(dataset: Dataset) -> None:
    batch = Windows(dataset, "train").gather(np.array([0, 20]))
    assert batch.ground.features.shape[1] == 12
    assert torch.isfinite(batch.ground.features[batch.ground.valid]).all()


def test_what_cannot_be_extracted_ends_in_one_line(folder: Path, tmp_path: Path) -> None:
    rig, pca = load_rig("proving_ground"), folder / "pca.safetensors"
    world = WorldSettings("uniform", size=100.0, resolution=0.5)
    simulate(DriveSettings(world, 3.0, seed=0, sensors="none"), tmp_path / "blind.mcap")
    with pytest.raises(LogError, match="LiDAR"):
        make_dataset([tmp_path / "blind.mcap"], rig, tmp_path / "d.zarr", pca=pca)
    with pytest.raises(DatasetError, match="both a PCA"):
        make_dataset([tmp_path / "blind.mcap"], rig, tmp_path / "e.zarr", pca=pca, features="ground-truth")
    with pytest.raises(DatasetError, match="another"):
        make_dataset([folder / "drive.mcap"], rig, folder / "data.zarr", split="blocks:1,0,0")
