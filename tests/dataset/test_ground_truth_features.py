"""True ground under recorded wheels: the same numbers whether read by row or on the map, and through the files."""

from pathlib import Path

import numpy as np
import torch

from factories import circle_rows, small_rig, stored_dataset, tilted_map
from offpiste.dataset.ground_truth_features import with_ground_truth
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.mapping.terrain_map import TerrainMap, wheel_positions
from offpiste.training.prediction import encoded, on_map
from offpiste.training.run import build, vehicle_of

NAMES = ("column", "row")


def truth(shape: tuple[int, int] = (800, 700)) -> TerrainMap:
    """A plane around the circles of `circle_rows`."""
    return tilted_map((0.2, -0.1), shape, (20.0, -140.0), 0.25)


def made(path: Path, split: str = "blocks:0.5,0.25,0.25") -> Dataset:
    for number in range(2):
        grounded = with_ground_truth(circle_rows(2400, seed=number, speed=4 + number), truth(), small_rig())
        dataset = stored_dataset(path, {f"drive {number}": grounded.rows}, split, NAMES, terrain=grounded.map)
    return dataset


def test_cells_are_those_under_the_wheels_each_once():
    rows, rig = circle_rows(600), small_rig()
    grounded = with_ground_truth(rows, truth(), rig)
    cells = grounded.rows.cells
    places = wheel_positions(rows.state[:, :2] + rows.origin, rows.state[:, 2], rig.wheel_positions())
    wanted = np.round((places - truth().origin) / truth().resolution)
    np.testing.assert_array_equal(cells.features[0, cells.index], wanted)
    assert len(np.unique(cells.features[0], axis=0)) == cells.features.shape[1]
    # Numbered by first visit.
    first = [np.flatnonzero((cells.index == n).any(axis=1))[0] for n in range(cells.features.shape[1])]
    assert (np.diff(first) >= 0).all()
    slope = -grounded.rows.normal[..., :2] / grounded.rows.normal[..., 2:]
    np.testing.assert_allclose(slope, np.broadcast_to([0.2, -0.1], slope.shape), atol=1e-4)


def test_wheels_off_the_map_have_no_cell_and_no_normal():
    grounded = with_ground_truth(circle_rows(600), truth(shape=(420, 330)), small_rig())
    away = grounded.rows.cells.index < 0
    assert 0 < away.mean() < 1
    assert np.isnan(grounded.rows.normal[0][away]).all()
    assert (grounded.rows.normal[0][~away][:, 2] < 1).all()


def test_recorded_and_predicted_places_read_the_same_ground(tmp_path):
    dataset = made(tmp_path / "data.zarr")
    windows = Windows(dataset, "test", start="smoothed")
    assert set(windows.drive) == {0, 1}
    index = np.arange(0, len(windows), 37)
    df = build("df", vehicle_of(dataset), seed=0)
    batch = encoded(df, windows.gather(index))
    mapped, source = on_map(df, windows, index, batch)
    torch.testing.assert_close(mapped.history.terrain.normal, batch.history.terrain.normal, atol=1e-4, rtol=0)
    assert (mapped.history.terrain.latent == batch.history.terrain.latent).all(dim=-1).float().mean() > 0.99
    for t in (1, 100, 249):
        # A vehicle that is predicted where it was recorded must find what was recorded.
        found = source.at(t, batch.target[:, t - 1])
        torch.testing.assert_close(found.normal, batch.terrain.normal[:, t], atol=1e-4, rtol=0)
        same = (found.latent == batch.terrain.latent[:, t]).all(dim=-1)
        # Float32 places may fall on the other side of a border between cells.
        assert same.float().mean() > 0.99
        torch.testing.assert_close(found.latent, batch.terrain.latent[:, t], atol=1.0, rtol=1e-3)


def test_maps_are_kept_only_where_predictions_are_evaluated(tmp_path):
    assert made(tmp_path / "data.zarr", "blocks:1,0,0").drives[0].load_map is None
    assert made(tmp_path / "other.zarr").drives[0].load_map().resolution == 0.25
