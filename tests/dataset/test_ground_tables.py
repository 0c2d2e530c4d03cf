"""Ground that lies on the device, by a budget in bytes, against ground that is read from disk: batches are the same."""

import numpy as np
import torch

from feature_datasets import dataset_with_features
from offpiste.dataset.feature_sets import FeatureSetChoice
from offpiste.dataset.features_under_wheels import CellTable
from offpiste.dataset.ground_tables import ResidentCells, free_budget, ground_tables
from offpiste.dataset.windows import Windows

CPU = torch.device("cpu")


def test_what_fits_is_resident_and_gives_the_same_batches(tmp_path):
    dataset = dataset_with_features(tmp_path / "data.zarr", rows=400)
    rows = [drive.rows for drive in dataset.drives]
    needed = sum(
        r.normal.nbytes + r.cells.features.nbytes + r.cells.valid.nbytes + 2 * r.cells.index.nbytes for r in rows
    )
    assert isinstance(ground_tables(dataset, CPU, needed - 1).cells, CellTable)
    ground = ground_tables(dataset, CPU, needed)
    assert isinstance(ground.cells, ResidentCells)
    kept = (ground.cells._index, ground.cells._valid, ground.cells._features, ground.normals._values)
    assert sum(part.nbytes for part in kept) == needed
    from_disk, from_device = Windows(dataset, "train"), Windows(dataset, "train", ground=ground)
    index, rng = np.array([0, 40, 7, 7, 90]), np.random.default_rng(0)
    choice = FeatureSetChoice(rng.integers(0, from_disk.sets, (5, 1)), rng.integers(0, from_disk.sets, 5))
    wanted, found = from_disk.gather(index, choice), from_device.gather(index, choice)
    assert torch.equal(found.terrain.normal, wanted.terrain.normal)
    assert torch.equal(found.history.terrain.known, wanted.history.terrain.known)
    for of_found, of_wanted in ((found.ground.past, wanted.ground.past), (found.ground.ahead, wanted.ground.ahead)):
        assert torch.equal(found.ground.valid[of_found], wanted.ground.valid[of_wanted])
        looks = found.ground.features[of_found], wanted.ground.features[of_wanted]
        torch.testing.assert_close(*looks, rtol=0, atol=0, equal_nan=True)
    starts = from_device.features_at_starts(), from_disk.features_at_starts()
    torch.testing.assert_close(*starts, rtol=0, atol=0, equal_nan=True)


def test_nothing_is_resident_on_the_processor_unless_it_is_given_room():
    assert free_budget(CPU) == 0
