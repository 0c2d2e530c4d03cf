"""Terrain along the driven path, codes of cells with repeatable gradients, and refused lookups on maps."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from factories import circle_rows, dataset_in_memory, torch_threads
from feature_datasets import dataset_with_features, with_snapshots
from offpiste.core.conventions import DT
from offpiste.core.errors import DatasetError
from offpiste.core.state import RecordedTerrain
from offpiste.dataset.resample import Rows
from offpiste.dataset.splits import Split
from offpiste.dataset.windows import Windows
from offpiste.dynamics import MODELS
from offpiste.training import prediction
from offpiste.training.prediction import PathTerrain, codes_of_cells, predict_windows
from offpiste.training.run import vehicle_of

SPEED = 5.0


def slope(s: np.ndarray) -> np.ndarray:
    """The slope after s metres: steeper all the way, so that the slope identifies the place."""
    return 0.001 * s


def hill(rows: int = 700) -> Rows:
    """A drive straight ahead along x, uphill."""
    flat = circle_rows(rows, speed=SPEED, yaw_rate=1e-6)
    s = flat.state[:, 0].astype(float)
    normal = np.stack((-slope(s), np.zeros(rows), np.ones(rows)), axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return replace(flat, normal=np.repeat(normal[None, :, None], 4, axis=2).astype(np.float32))


def windows(**drives: Rows) -> Windows:
    split = Split("all", "drives", drives=tuple((name, "test") for name in drives))
    return Windows(dataset_in_memory(drives, split), "test", start="smoothed")


def slopes(normal: torch.Tensor) -> np.ndarray:
    return (-normal[..., 0, 0] / normal[..., 0, 2]).numpy()


@pytest.fixture
def uphill() -> Windows:
    return windows(hill=hill())


def test_following_the_record_reads_the_recorded_ground_at_any_step(uphill: Windows) -> None:
    index = np.array([0, 100, len(uphill) - 1])
    batch = uphill.gather(index)
    source, recorded = PathTerrain(*uphill.path(index)), RecordedTerrain(batch.terrain)
    state = batch.state
    for t in range(uphill.horizon):
        assert torch.equal(source.at(0, state).normal, recorded.at(t, state).normal)
        state = batch.target[:, t]


def test_a_lagging_vehicle_reads_the_ground_at_its_own_place(uphill: Windows) -> None:
    index = np.array([40])
    batch = uphill.gather(index)
    source = PathTerrain(*uphill.path(index))
    start = SPEED * DT * float(uphill.row_in_drive(index)[0])
    for t, behind in ((0, 0.0), (100, 4.0), (249, 20.0)):
        state = batch.target[:, t].clone()
        state[:, 0] -= behind
        where = start + SPEED * DT * (t + 1) - behind
        found = slopes(source.at(t, state).normal)
        np.testing.assert_allclose(found, slope(np.array([where])), atol=1e-5)
    assert slopes(batch.terrain.normal[:, 249]) - found > 0.019  # the record would reveal the lag
    beside = batch.state.clone()
    beside[:, 0], beside[:, 1] = 12.0, 3.0
    found = slopes(source.at(0, beside).normal)
    np.testing.assert_allclose(found, slope(np.array([start + 12.0])), atol=0.001 * SPEED * DT)


def test_rows_of_other_drives_and_invalid_rows_are_not_read() -> None:
    rows = hill(400)
    rows.valid[320:] = False
    rows.state[350:] = np.nan
    both = windows(hill=rows, valley=hill(400))
    last = np.flatnonzero(both.drive == 0)[-1]
    position, _ = both.path(np.array([last]))
    known = torch.isfinite(position).all(dim=-1)[0]
    row = int(both.row_in_drive(np.array([last]))[0])
    assert known.tolist() == [0 <= r < 320 for r in range(row - 50, row + 401)]
    far = both.gather(np.array([last])).state.clone()
    far[:, 0] = 1000.0
    found = PathTerrain(*both.path(np.array([last]))).at(0, far)
    np.testing.assert_allclose(slopes(found.normal), slope(np.array([SPEED * DT * 319])), atol=1e-5)


def test_a_prediction_that_is_not_finite_finds_ground(uphill: Windows) -> None:
    source = PathTerrain(*uphill.path(np.array([0])))
    for value in (torch.nan, torch.inf):
        terrain = source.at(0, torch.full((1, 6), value))
        assert torch.isfinite(terrain.normal).all()
        assert terrain.latent.shape == (1, 4, 0)


WAYS = [(torch.float32, 4), (torch.float64, 4), (torch.float64, 2), (torch.float16, 8)]
"""Kernels of the CPU, rows of other lengths, and rows of 16 bytes."""


def codes_read(way=codes_of_cells, dtype=torch.float64, size=4, cells=None) -> tuple[torch.Tensor, torch.Tensor]:
    """Codes and the gradient of a weighted sum; a quarter of the cells is never read."""
    draw = torch.Generator().manual_seed(0)
    cells = torch.randint(0, 225, (64, 250, 4), generator=draw, dtype=torch.int32) if cells is None else cells
    codes = torch.randn(300, size, generator=draw).to(dtype).requires_grad_()
    weight = torch.randn(*cells.shape, size, generator=draw).to(dtype)
    found = way(codes, cells)
    (found * weight).sum().backward()
    return found.detach(), codes.grad


def indexed(codes: torch.Tensor, cells: torch.Tensor) -> torch.Tensor:
    return codes[cells]


@pytest.mark.parametrize(("dtype", "size"), WAYS)
def test_codes_and_gradients_equal_those_of_indexing_and_repeat(dtype, size) -> None:
    """The gradient of indexing itself adds the contributions of threads in any order."""
    with torch_threads(4):
        (codes, first), *others = (codes_read(dtype=dtype, size=size) for _ in range(6))
    assert all(torch.equal(first, gradient) for _, gradient in others)
    expected, gradient = codes_read(indexed, dtype, size)
    assert torch.equal(codes, expected)
    tolerance = {torch.float16: 0.5, torch.float32: 1e-4, torch.float64: 1e-10}[dtype]
    torch.testing.assert_close(first, gradient, atol=tolerance, rtol=0.02 if dtype == torch.float16 else 1e-5)
    assert (first[225:] == 0).all()
    assert (first[:225] != 0).any(dim=1).all()
    codes = torch.zeros(3, size, dtype=dtype)
    codes[1] = torch.nan
    found = codes_of_cells(codes, torch.tensor([[1, 0], [2, 1]]))
    assert found.isnan().all(dim=-1).tolist() == [[True, False], [False, True]]
    empty, gradient = codes_read(dtype=dtype, size=size, cells=torch.zeros((0, 4), dtype=torch.int64))
    assert empty.shape == (0, 4, size)
    assert (gradient == 0).all()


def test_gradients_of_codes_do_not_need_the_compiled_library(monkeypatch: pytest.MonkeyPatch) -> None:
    _, wanted = codes_read(dtype=torch.float32)
    monkeypatch.setattr(prediction, "library", lambda: None)
    torch.testing.assert_close(codes_read(dtype=torch.float32)[1], wanted)


def test_training_drives_are_not_read_on_the_driven_path_if_others_have_maps(tmp_path: Path) -> None:
    """In a dataset with features the path's normals are the map's in hindsight."""
    dataset = dataset_with_features(tmp_path / "seen.zarr")
    snapped = with_snapshots(dataset, tmp_path / "snapshots", [100])

    def refused(snapshots: bool, maps: bool, what: str) -> None:
        drives = tuple(
            replace(
                drive,
                snapshots=drive.snapshots if snapshots and drive.part.all() else None,
                load_map=drive.load_map if maps else None,
            )
            for drive in snapped.drives
        )
        windows = Windows(replace(dataset, drives=drives), "train")
        with pytest.raises(DatasetError, match=what):
            predict_windows(MODELS["dc"](vehicle_of(dataset), seed=0), windows[:2], "map")

    refused(snapshots=True, maps=False, what="2 of 2 windows do not start with a snapshot of the map")
    refused(snapshots=False, maps=True, what="drive 'circle-0' has no map")
    refused(snapshots=False, maps=False, what="drive 'circle-0' has no map")
