"""Windows as drives of their own: the usual features are the usual batch, a snapshot's are those of its map."""

import numpy as np
import pytest
import torch

from experiments.control_experiments.snapshots import own_drives, read_as_stored, read_on_snapshot
from feature_datasets import dataset_with_features, with_snapshots
from offpiste.conventions import FEATURE_SETS
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.mapping.terrain_map import wheel_positions

ROWS = (20, 75, 300, 880)
"""The last one is too near the end for a window."""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("data")
    return with_snapshots(dataset_with_features(folder / "seen.zarr"), folder / "snapshots", ROWS)


def test_the_usual_features_give_the_usual_batch(dataset: Dataset) -> None:
    own = Windows(own_drives(dataset, read_as_stored), "train")
    whole = Windows(dataset, "train")
    assert len(own) == 2 * (len(ROWS) - 1)  # two drives train
    at = [i for i in range(len(whole)) if whole.row_in_drive(np.array([i]))[0] in ROWS]
    for name in (FEATURE_SETS[0], FEATURE_SETS[6]):
        one, two = (
            own.with_feature_set(name).gather(np.arange(len(own))),
            whole.with_feature_set(name).gather(np.array(at)),
        )
        torch.testing.assert_close(one.history.state, two.history.state)
        torch.testing.assert_close(one.target, two.target)
        torch.testing.assert_close(one.terrain.normal, two.terrain.normal)
        assert one.ground is not None
        assert two.ground is not None
        for where in ("past", "ahead"):
            mine, others = (g.features[getattr(g, where)] for g in (one.ground, two.ground))
            torch.testing.assert_close(mine, others, equal_nan=True)


def test_a_snapshot_is_read_under_the_recorded_wheels(dataset: Dataset) -> None:
    made = own_drives(dataset, read_on_snapshot)
    drive = next(d for d in made.drives if d.name == "circle-1@75")
    source = next(d for d in dataset.drives if d.name == "circle-1")
    assert source.snapshots is not None
    terrain = source.snapshots.load(1)
    cells = drive.rows.cells
    assert cells is not None
    assert len(cells.features) == 1
    for row in (0, 10, 200):
        state = source.rows.state[75 - 10 + row].astype(np.float64)
        places = wheel_positions(state[None, :2] + source.rows.origin, state[None, 2], dataset.rig.wheel_positions())[0]
        column, line = np.round((places - terrain.origin) / terrain.resolution).astype(int).T
        found = cells.features[0, cells.index[row]]
        np.testing.assert_allclose(found, terrain.features[line, column], atol=2e-3)
    up = np.array([-0.1, 0.2, 1.0]) / np.sqrt(1.05)
    np.testing.assert_allclose(drive.rows.normal[0, 50, 0], up, atol=1e-3)
