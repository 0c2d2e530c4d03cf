"""The pipeline never draws from the global generators of torch, NumPy and `random`."""

import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch

import kill
from offpiste.dataset.fit_pca import fit_pca
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import open_dataset
from offpiste.dynamics.lstm import Compensator
from offpiste.evaluation.evaluate import EvaluatedModel, evaluate_models
from offpiste.perception.backbones import open_backbone
from offpiste.rig.rig import load_rig
from offpiste.training.config import TrainConfig
from offpiste.training.run import load_run
from offpiste.training.train import train
from offpiste.uncertainty.fit import load_spread
from offpiste.uncertainty.novelty import load_memory_bank

QUICK = {"epochs": 1, "bicycle_epochs": 1, "actuator_epochs": 1, "stride": 60, "batch": 32}


def refuse(*_: object, **__: object) -> None:
    """Stands in for the functions of `random`."""
    raise AssertionError("drawn from the global generator of random")


@contextmanager
def undrawn() -> Iterator[None]:
    """Fails if something inside draws from a global generator."""
    # The state of `random` would not do: beartype, which checks types in tests, draws from it.
    functions = [name for name in random.__all__ if callable(getattr(random, name)) and name[0].islower()]
    before = torch.get_rng_state(), repr(np.random.get_state())  # noqa: NPY002
    with pytest.MonkeyPatch.context() as patch:
        for name in functions:
            patch.setattr(random, name, refuse)
        yield
    assert torch.equal(before[0], torch.get_rng_state()), "drawn from the global generator of torch"
    assert before[1] == repr(np.random.get_state()), "drawn from the global generator of NumPy"  # noqa: NPY002


@pytest.mark.parametrize(
    "draw",
    [
        lambda: Compensator(2, 1),
        lambda: torch.randn(1),
        lambda: np.random.rand(),  # noqa: NPY002
        lambda: random.random(),
        lambda: random.shuffle([1, 2]),
    ],
)
def test_a_draw_is_noticed(draw: Callable[[], object]) -> None:
    with pytest.raises(AssertionError, match="drawn from"), undrawn():
        draw()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("poison")
    with undrawn():
        kill.make_inputs(folder, kill.WORK)
    return folder


def test_a_pca_is_fitted_without_an_unseeded_draw(folder: Path) -> None:
    with undrawn():
        split, backbone = parse_split("blocks:1,0,0"), open_backbone("filterbank")
        fit_pca([folder / "one.mcap"], load_rig("proving_ground"), split, backbone, images=3, components=4)


def test_drives_are_extracted_without_an_unseeded_draw(folder: Path, tmp_path: Path) -> None:
    with undrawn():
        kill.extract_drives(folder, tmp_path)


def test_models_are_trained_and_evaluated_without_an_unseeded_draw(folder: Path, tmp_path: Path) -> None:
    with undrawn():
        dataset = open_dataset(folder / "features.zarr")
        for model in ("b", "dc"):
            train(dataset, TrainConfig(model=model, **QUICK), tmp_path / model)
        runs = [load_run(tmp_path / model) for model in ("b", "dc")]
        models = [EvaluatedModel(run.model, run.dynamics, seed=run.seed) for run in runs]
        evaluate_models(models, dataset, scale=runs[0].scale, stride=100, lookups=("recorded",))
    assert (tmp_path / "b" / "actuators.safetensors").exists(), "networks of actuators are drawn, too"


def test_what_lies_beside_weights_is_read_without_an_unseeded_draw() -> None:
    with undrawn():
        run = load_run("pretrained:proving-ground/dc")
        spread, bank = load_spread(run), load_memory_bank(run)
    assert len(spread.state_dict())
    assert len(bank.kept)


def test_a_course_is_planned_and_driven_without_an_unseeded_draw(folder: Path, tmp_path: Path) -> None:
    with undrawn():
        kill.drive_closed_loop(folder, tmp_path)
