"""Visual features by distance from a simulated drive with camera and LiDAR, against the simulator's truth."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from cli.command import run
from log_messages import logged
from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.errors import DatasetError, LogError
from offpiste.dataset.fit_pca import fit_pca
from offpiste.dataset.splits import parse_split, write_drives
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.inspection.extract import extract
from offpiste.logs.ground_truth import read_truth_map
from offpiste.mapping.terrain_map import wheel_positions
from offpiste.perception.backbones import open_backbone
from offpiste.rig.rig import load_rig
from offpiste.simulation.simulate import DriveSettings, simulate
from offpiste.simulation.world.grids import read_grid
from offpiste.simulation.world.world import WorldSettings

PARTS_OF_DRIVES = (("drive", "train"), ("other", "train"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("visual")
    world = WorldSettings("mojave", seed=3, size=120.0, resolution=0.5)
    simulate(DriveSettings(world, 12.0, seed=1, sensors="light"), folder / "drive.mcap")
    options = "--rig proving_ground --backbone filterbank --images 6 --components 12 --split blocks:1,0,0 --out"
    assert run("fit-pca", folder / "drive.mcap", *options.split(), folder / "pca.safetensors") == 0
    assert len((folder / "pca.images.txt").read_text().splitlines()) == 6
    return folder


@pytest.fixture(scope="module")
def dataset(folder: Path) -> Dataset:
    split = write_drives(folder / "parts.txt", [("drive", "test")])
    with logged() as said:
        logs, pca = [folder / "drive.mcap"], folder / "pca.safetensors"
        made = extract(logs, load_rig("proving_ground"), folder / "data.zarr", split=split, pca=pca)
    found = [line for line in said if "compil" not in line]  # kernels may be compiled here or in another process
    assert "leaves nothing for train and validation" in found[0]
    assert "valid by distance: hindsight" in found[1]
    assert "snapshots of the map" in found[1]
    assert "warning: the PCA may have seen" in found[1]
    return made


def test_processes_fit_the_pca_that_one_does_whatever_the_order_of_the_logs(folder: Path, tmp_path: Path) -> None:
    logs = [folder / "drive.mcap", shutil.copyfile(folder / "drive.mcap", tmp_path / "other.mcap")]
    rig, split = load_rig("proving_ground"), parse_split(write_drives(tmp_path / "parts.txt", PARTS_OF_DRIVES))
    alone, shared = (
        fit_pca(given, rig, split, open_backbone("filterbank"), images=6, components=4, processes=processes)
        for processes, given in ((1, logs), (2, logs[::-1]))
    )
    assert shared.images == alone.images
    assert {image.drive for image in alone.images} == {"drive", "other"}
    assert shared.pca.identity == alone.pca.identity
    assert shared.pca.fitted_on["split_drives"] == [list(pair) for pair in PARTS_OF_DRIVES]


def test_every_feature_set_is_there_and_was_observed_at_its_distance(dataset: Dataset) -> None:
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
    places = wheel_positions(rows.state[:, :2] + rows.origin, rows.state[:, 2].astype(float), rig.wheel_positions())
    under = rows.cells.index
    here = rows.cells.elevation[0][under]
    known = (under >= 0) & np.isfinite(here)
    wanted = read_grid(truth.layers["elevation"], truth.origin, truth.resolution, places[known])
    assert known.mean() > 0.8
    assert np.median(np.abs(here[known] - wanted)) < 0.06
    rise_y, rise_x = np.gradient(truth.layers["elevation"], truth.resolution)
    slope = read_grid(np.stack((rise_x, rise_y), axis=-1), truth.origin, truth.resolution, places[known])
    normal = rows.normal[0][known]
    fitted = np.isfinite(normal).all(axis=1)
    assert fitted.mean() > 0.9
    assert np.median(np.abs(-normal[fitted, :2] / normal[fitted, 2:] - slope[fitted])) < 0.06


def test_what_the_map_did_not_know_is_said_to_be_unknown(dataset: Dataset) -> None:
    normal = dataset.drives[0].rows.normal
    unknown = np.isnan(normal).any(axis=-1)
    np.testing.assert_array_equal(unknown, np.isnan(normal).all(axis=-1))
    share = dict(zip(FEATURE_SETS, unknown.mean(axis=(1, 2)), strict=True))
    assert share["hindsight"] < share["20"] < share["40"]
    assert (np.abs(np.linalg.norm(normal[~unknown], axis=-1) - 1) < 1e-3).all()
    index = Windows(dataset, "test").every(25)
    assert torch.isfinite(Windows(dataset, "test", feature_set="40").gather(index).terrain.normal).all()


def test_what_cannot_be_extracted_ends_in_one_line_and_good_drives_stay(folder: Path, tmp_path: Path) -> None:
    rig, pca = load_rig("proving_ground"), folder / "pca.safetensors"
    world = WorldSettings("uniform", size=100.0, resolution=0.5)
    simulate(DriveSettings(world, 3.0, seed=0, sensors="none"), tmp_path / "blind.mcap")
    with pytest.raises(LogError, match="LiDAR"):
        extract([tmp_path / "blind.mcap"], rig, tmp_path / "d.zarr", pca=pca, force=True)
    (tmp_path / "bad.mcap").write_bytes(b"nonsense")
    both = [tmp_path / f"{name}.mcap" for name in ("bad", "blind")]
    with pytest.raises(LogError, match=r"bad\.mcap"):
        extract(both, rig, tmp_path / "d.zarr", processes=2, force=True)
    (tmp_path / "d.zarr" / ".blind.x.partial").mkdir()  # as a killed run leaves it
    with logged() as said:
        extract([tmp_path / "blind.mcap"], rig, tmp_path / "d.zarr", force=True)
    assert said == ["blind: already there"]
    assert not (tmp_path / "d.zarr" / ".blind.x.partial").exists()
    with pytest.raises(DatasetError, match="both a PCA"):
        extract([tmp_path / "blind.mcap"], rig, tmp_path / "e.zarr", pca=pca, features="ground-truth")
    with pytest.raises(DatasetError, match="another"):
        extract([folder / "drive.mcap"], rig, folder / "data.zarr", split="blocks:1,0,0", force=True)
    with pytest.raises(DatasetError, match="invalid --min-hindsight 2"):
        extract([folder / "drive.mcap"], rig, tmp_path / "f.zarr", pca=pca, min_hindsight=2.0)
