"""Snapshots: their cells, their windows and their files; predictions read them like the whole map."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from factories import circle_rows, small_rig, stored_dataset, tilted_map
from offpiste.core.errors import DatasetError
from offpiste.dataset import store
from offpiste.dataset.ground_truth_features import with_ground_truth
from offpiste.dataset.map_snapshots import (
    CellList,
    SnapshotSchedule,
    SnapshotSettings,
    SnapshotWriter,
    crop,
    open_snapshots,
    stack_cells,
)
from offpiste.dataset.splits import PARTS, parse_split
from offpiste.dataset.window_starts import evaluation_starts
from offpiste.dataset.windows import Windows
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.mapping.terrain_sampler import MapTerrain, sample_maps, stack_maps

SPLIT = parse_split("blocks:0.5,0.25,0.25")
NAMES = ("column", "row")
SLOPE = (0.25, -0.125)


def tilted() -> TerrainMap:
    """A plane of 0.25 m cells, of which a stripe is unknown and another one lacks features."""
    plane = tilted_map(SLOPE, (900, 800), (10.0, -150.0), 0.25)
    rise = np.full((900, 800, 2), SLOPE, np.float32)
    for values in (plane.elevation, plane.features, rise):
        values[:, 300:304] = np.nan
    plane.features[:, 310:312] = np.nan
    return dataclasses.replace(plane, rise=rise)


def centres(cells: CellList) -> np.ndarray:
    """Places of listed cells of 0.25 m in the world [m]."""
    row, column = np.divmod(cells.place, cells.shape[1])
    return cells.origin + 0.25 * np.stack((column, row), axis=-1)


def test_only_known_cells_are_kept_and_come_back_in_their_places(tmp_path):
    terrain = tilted()
    writer = SnapshotWriter(tmp_path / "s", terrain.resolution, 2)
    states = [np.array([60.0 + 5 * n, 10.0 * n, 0.3 * n, 3.0, 0.0, 0.0]) for n in range(4)]
    cells = [crop(terrain, state) for state in states]
    for number, kept in enumerate(cells):
        writer.add(100 * number, kept)
    writer.close()
    snapshots = open_snapshots(tmp_path / "s")
    np.testing.assert_array_equal(snapshots.row, [0, 100, 200, 300])
    for number, kept in enumerate(cells):
        found = snapshots.load(number)
        first = np.round((found.origin - terrain.origin) / 0.25).astype(int)
        ny, nx = found.elevation.shape
        original = terrain.elevation[first[1] : first[1] + ny, first[0] : first[0] + nx]
        known = np.isfinite(found.elevation)
        assert known.sum() == len(kept.place) == np.isfinite(kept.elevation).sum()
        np.testing.assert_array_equal(found.elevation[known], original[known].astype(np.float32))
        column = found.features[known][:, 0]
        np.testing.assert_array_equal(
            column[np.isfinite(column)], (np.nonzero(known)[1] + first[0])[np.isfinite(column)]
        )
        assert (np.isnan(found.features).all(axis=2) == (~known | np.isnan(found.features[..., 0]))).all()


def test_snapshots_keep_their_distance_and_their_number():
    starts = np.zeros(1000, bool)
    starts[100:900] = True
    other = np.zeros(1000, bool)
    other[905:990] = True
    due = SnapshotSchedule([starts, other], SnapshotSettings(seconds=0.5))
    rows = [row for row in range(0, 1000, 5) if due.at(row)]
    assert rows == [*range(100, 900, 25), *range(905, 990, 25)]
    few = SnapshotSchedule([starts], SnapshotSettings(seconds=0.1, most=10))
    assert [row for row in range(1000) if few.at(row)] == list(range(100, 900, 80))
    assert not few.at(-3)
    assert not few.at(5000)


def made(path: Path) -> store.Dataset:
    """Two drives on a whole map, the same map as snapshots beside it in one part of the windows."""
    for number in range(2):
        rows = with_ground_truth(circle_rows(2400, seed=number, speed=4 + number), tilted(), small_rig()).rows
        part = SPLIT.label("", rows.world_xy)
        writer = SnapshotWriter(path.with_suffix(".snapshots"), 0.25, 2)
        for row in evaluation_starts(rows, part == PARTS.index("test"))[::20]:
            state = rows.state_causal[row].astype(np.float64)
            state[:2] += rows.origin
            writer.add(int(row), crop(tilted(), state))
        writer.close()
        maps = {"terrain": tilted(), "snapshots": path.with_suffix(".snapshots")}
        dataset = stored_dataset(path, {f"drive {number}": rows}, SPLIT, NAMES, **maps)
    return dataset


def test_predictions_read_snapshots_as_they_read_the_whole_map(tmp_path):
    dataset = made(tmp_path / "d.zarr")
    assert not list((tmp_path / "d.zarr").glob(".*"))
    windows = Windows(dataset, "test")
    index = windows.evaluation_indices(5)
    assert 4 < len(index) < len(windows.every(5))
    assert np.array_equal(index, np.flatnonzero(windows.maps.snapped))
    whole = [dataclasses.replace(drive, snapshots=None) for drive in dataset.drives]
    plain = Windows(dataclasses.replace(dataset, drives=tuple(whole)), "test")
    assert np.array_equal(plain.evaluation_indices(5), plain.every(5))
    generator = torch.Generator().manual_seed(0)
    # As far as 5 s reach at these speeds, and further: there a snapshot knows nothing.
    state = torch.randn(len(index), 6, generator=generator) * torch.tensor([8.0, 8.0, 2.0, 1.0, 1.0, 1.0])

    def read(windows: Windows) -> MapTerrain:
        maps, number = windows.maps.of(index)
        assert (number >= 0).all()
        encode = lambda features, valid: torch.where(valid[:, None], features, -1.0)  # noqa: E731
        return MapTerrain(maps, torch.as_tensor(number), windows.places(index), windows.wheels, encode)

    snapped, mapped = read(windows).at(0, state), read(plain).at(0, state)
    assert (snapped.latent == mapped.latent).all()
    assert torch.allclose(snapped.normal, mapped.normal, atol=1e-4)
    far = state + torch.tensor([0.0, 500.0, 0.0, 0.0, 0.0, 0.0])
    assert (read(windows).at(0, far).latent == -1).all()


@pytest.mark.parametrize("value", [np.nan, -1.0])
@pytest.mark.parametrize("name", ["seconds", "min_speed"])
def test_impossible_settings_are_refused(name: str, value: float) -> None:
    with pytest.raises(DatasetError, match="give a"):
        SnapshotSettings(**{name: value})


def test_a_snapshot_reaches_as_far_as_five_seconds_and_a_margin():
    flat = tilted_map((0.0, 0.0), (481, 481), (-60.0, -60.0), 0.25)
    flat = dataclasses.replace(flat, rise=np.zeros((481, 481, 2), np.float32))
    for yaw, speed in ((0.0, 4.0), (np.pi / 2, 4.0), (1.0, 0.0), (2.0, -0.1), (3.0, -4.0)):
        ahead = (-1 if speed < -1 else 1) * np.array([np.cos(yaw), np.sin(yaw)])
        cells = crop(flat, np.array([1.0, 2.0, yaw, speed, 0.0, 0.0]))  # a disc of 10 + 18 m, 10 m ahead
        along = (centres(cells) - [1.0, 2.0]) @ ahead
        assert along.max() == pytest.approx(38.0, abs=0.13)
        assert along.min() == pytest.approx(-18.0, abs=0.13)
        assert len(along) == pytest.approx(np.pi * 28**2 / 0.25**2, rel=0.01)


def holed(rng: np.random.Generator, shape: tuple[int, int]) -> tuple[TerrainMap, CellList]:
    """A map with random holes, and the list of its cells."""
    known, origin = rng.random(shape) < 0.9, rng.uniform(-20, 20, 2)
    flat = np.where(known, 0.0, np.nan).astype(np.float32)
    seen = known & (rng.random(shape) < 0.8)
    features = np.where(seen[..., None], rng.normal(size=(*shape, 3)), np.nan).astype(np.float16)
    rise = np.where(known[..., None], rng.normal(size=(*shape, 2)), np.nan).astype(np.float16)
    place = np.flatnonzero(known).astype(np.int32)
    cells = CellList(origin, 0.25, shape, place, flat[known], rise[known], features[known])
    return TerrainMap(origin, 0.25, flat, features, rise), cells


def test_lists_of_cells_are_read_as_the_maps_they_are_lists_of():
    rng = np.random.default_rng(0)
    maps, cells = zip(*(holed(rng, shape) for shape in ((30, 50), (60, 20), (5, 7))), strict=True)
    dense, listed = stack_maps(maps), stack_cells(cells)
    assert dense.shape == listed.place.shape[1:] == (60, 50)
    number = torch.as_tensor(rng.integers(3, size=4000))
    place = torch.as_tensor(np.stack([m.origin for m in maps])[number] + rng.uniform(-2, 16, (4000, 2)))
    one, other = (sample_maps(stack, number, place, torch.zeros_like(place)) for stack in (dense, listed))
    assert 100 < one.known.sum() < one.valid.sum() < 2000
    for name in ("normal", "known", "features", "valid"):
        torch.testing.assert_close(getattr(other, name), getattr(one, name), rtol=0, atol=0, equal_nan=True)


def test_cells_near_a_path_are_those_within_the_margin():
    terrain, cells = holed(np.random.default_rng(1), (80, 120))
    path = terrain.origin + np.array([[5.0, 5.0], [8.0, 9.0], [11.0, 10.0]])
    near, nowhere = cells.near(path, 3.0), cells.near(path + 1000.0, 3.0)
    within = np.hypot(*(centres(cells)[:, None] - path).transpose(2, 0, 1)).min(axis=1) <= 3.0
    np.testing.assert_allclose(centres(near), centres(cells)[within])
    for name in ("elevation", "rise", "features"):
        np.testing.assert_array_equal(getattr(near, name), getattr(cells, name)[within])
    assert near.shape[0] < 60
    assert (nowhere.shape, len(nowhere.place)) == ((1, 1), 0)
