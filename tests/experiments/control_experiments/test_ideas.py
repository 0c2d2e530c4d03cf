"""Ideas for better codes: what each changes of a dataset, distillation, and one from end to end."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from experiments.control_experiments import ideas
from experiments.control_experiments.distilled import teach, views
from experiments.control_experiments.ideas import BLIND_SPOT, ideas_control, with_distance, with_farther_views
from experiments.control_experiments.models import trained
from experiments.control_experiments.reproduced import Reproduced, open_reproduction
from feature_datasets import FEATURES, dataset_with_features, with_snapshots
from offpiste.conventions import FEATURE_SETS
from offpiste.dataset.store import Dataset
from offpiste.dynamics.feature_encoder import Compressor
from offpiste.reproduction.settings import Size
from offpiste.training.config import TrainConfig
from offpiste.training.run import Run

SIZE = Size("tiny", (72.0, 18.0, 18.0), stride=320, train=TrainConfig(epochs=1, bicycle_epochs=1, batch=64, stride=80))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("ideas")
    return with_snapshots(dataset_with_features(folder / "dataset.zarr"), folder / "snapshots", [200])


def test_the_distance_is_the_first_feature_of_cells_and_maps(dataset: Dataset) -> None:
    drive, before = with_distance(dataset).drives[0], dataset.drives[0]
    cells = before.rows.cells
    first = drive.rows.cells.features[..., 0]
    np.testing.assert_allclose(first, np.log(np.maximum(cells.distance, 1)), atol=2e-3)
    np.testing.assert_array_equal(drive.rows.cells.features[..., 1:], cells.features)
    known = drive.snapshots.known_cells(0)
    start = before.rows.state_causal[200, :2].astype(np.float64) + before.rows.origin
    row, column = np.divmod(known.place, known.shape[1])
    x, y = (known.origin[axis] + 0.4 * number for axis, number in enumerate((column, row)))
    away = np.hypot(x - start[0], y - start[1])
    assert away.min() < BLIND_SPOT < away.max()
    np.testing.assert_allclose(np.exp(known.features[:, 0].astype(float)), away.clip(BLIND_SPOT), rtol=2e-3)
    assert known.features.shape[1] == FEATURES + 1


def test_the_farther_view_is_that_of_the_next_set_or_the_own(dataset: Dataset) -> None:
    drive, cells = with_farther_views(2, dataset).drives[0], dataset.drives[0].rows.cells
    features = drive.rows.cells.features
    assert features.shape[-1] == 4
    assert drive.snapshots is None
    ten, twenty, last = FEATURE_SETS.index("10"), FEATURE_SETS.index("20"), len(FEATURE_SETS) - 1
    for own, farther in ((0, ten), (ten, twenty), (last, last)):
        np.testing.assert_array_equal(features[own, :, :2], cells.features[own, :, :2])
        other = np.where(cells.valid[farther][:, None], cells.features[farther], cells.features[own])[:, :2]
        np.testing.assert_array_equal(features[own, :, 2:], other)


def code_of(encoder: Compressor, value: float) -> float:
    return float(encoder(torch.tensor([[value]]), torch.tensor([True])).detach())


def test_a_distilled_code_is_the_one_expected_of_what_is_seen() -> None:
    torch.manual_seed(0)
    rng, encoder = np.random.default_rng(0), Compressor(1, size=1)
    telling, random = rng.choice([-1.0, 1.0], (2, 4000))
    features = np.stack((telling, telling, random))[..., None].astype(np.float16)  # the last view tells nothing
    valid = np.ones(features.shape[:2], bool)
    one, other = (code_of(encoder, value) for value in (-1.0, 1.0))
    only_last = Compressor(1, size=1)
    only_last.load_state_dict(encoder.state_dict())
    teach(encoder, features[[0, 0]], valid[[0, 0]], 0, steps=600)
    found = [code_of(encoder, value) for value in (-1.0, 1.0)]
    assert found == pytest.approx([one, other], abs=0.05 * abs(one - other))
    teach(
        only_last,
        np.stack((features[0], features[2], features[2], features[2])),
        np.ones((4, 4000), bool),
        0,
        steps=600,
    )
    found = [code_of(only_last, value) for value in (-1.0, 1.0)]
    mean = (one + other) / 2
    # A quarter of the views tells all, the others nothing.
    assert found == pytest.approx([mean + (one - mean) / 4, mean + (other - mean) / 4], abs=0.1 * abs(one - other))


def test_only_cells_that_hindsight_knows_are_taught(dataset: Dataset) -> None:
    features, valid = views(dataset, 3)
    train = [drive.rows.cells for drive in dataset.drives if (drive.part == 0).all()]
    assert features.shape == (len(FEATURE_SETS), sum(int(cells.valid[0].sum()) for cells in train), 3)
    assert valid[0].all()
    assert not valid.all()


def briefly(of: Reproduced, runs: Path, seed: int) -> Run:
    """`distilled` in a few steps."""
    run = of.runs("cf")[seed]
    teach(run.dynamics.encoder, *views(of.dataset, FEATURES), seed, steps=20)
    return replace(run, folder=runs / f"distilled-{seed}")


def test_ideas_from_end_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ideas, "IDEAS", {**ideas.IDEAS, "distilled": replace(ideas.IDEAS["distilled"], made=briefly)})
    folder = tmp_path / "reproduced"
    folder.mkdir()
    dataset_with_features(folder / "dataset.zarr")
    (folder / "settings.json").write_text(json.dumps({"size": asdict(SIZE), "dataset": "simulated"}))
    of = open_reproduction(folder)
    for model in ("b", "cf", "dc"):
        trained(of.dataset, of.member(model).config(of.size, 0, "cpu"), folder / "runs")
    page = ideas_control(of, tmp_path / "controls", ["as seen", "distilled"], 3)
    gains = json.loads((page.parent / "control.json").read_text("utf-8"))["gains"]
    assert [gain["model"] for gain in gains] == ["as seen"] * 4 + ["distilled"] * 4
    assert all(gain["levels"]["seeds"] == 1 for gain in gains), "as many seeds as there are of dc"
    assert all(np.isfinite(gain["error_m"]) and gain["baseline"] == "dc" for gain in gains)
    assert (page.parent / "as-seen" / "runs" / "dc-view-0" / "model.json").exists()
