"""Loading of planners, their warm-up, and codes computed on a GPU."""

from dataclasses import asdict

import numpy as np
import pytest
import torch

from fake_gpu import GPU, Faking, FromNumbers
from feature_datasets import random_pca
from offpiste.core.checksums import sha256_of
from offpiste.core.conventions import CONTROL
from offpiste.core.errors import PlanningError, RunError
from offpiste.dynamics import Vehicle
from offpiste.logs.ground_truth import GROUND_PROPERTIES
from offpiste.perception.backbones import open_backbone
from offpiste.perception.pca import save_pca
from offpiste.rig.rig import load_rig
from offpiste.runtime.perception import SensorSetup, codes_of, encoder_on
from offpiste.runtime.planner import load_planner, warm_up
from offpiste.runtime.runtime import Runtime
from offpiste.training.checkpoint import save_beside_weights, save_json, save_tensors
from offpiste.training.config import Weights
from offpiste.training.losses import COMPONENTS
from offpiste.training.run import build, differing_vehicle
from offpiste.uncertainty.fit import FILE
from offpiste.uncertainty.spread import Spread, inputs_of
from runtime.stream import WHEELS, extract_features, feature_model, parametric, sensor_setup, settings

BACKBONE = open_backbone("filterbank")


def pca_file(path, seed):
    pca = random_pca(BACKBONE, seed)
    save_pca(path, pca)
    return pca.identity


def run_folder(folder, model, names, vehicle=None, pca=None):
    """Folder of an untrained run."""
    vehicle = vehicle or Vehicle(1150.0, 2.06, 0.5, CONTROL, (), features=len(names))
    save_tensors(folder / "model.safetensors", build(model, vehicle, seed=0).state_dict())
    about = {
        "model": model,
        "weights_sha256": sha256_of(folder / "model.safetensors"),
        "seed": 0,
        "vehicle": asdict(vehicle),
        "loss": {"weights": asdict(Weights()), "scale": dict.fromkeys(COMPONENTS, 1.0)},
        "dataset": str(folder / "dataset.zarr"),
        "split": "blocks:0.7,0.1,0.2",
        "seen": [],
        "features": names,
        "pca": pca,
    }
    save_json(folder / "model.json", about)
    return folder


def test_a_run_of_visual_features_needs_its_own_pca(tmp_path):
    mine, others = tmp_path / "mine.safetensors", tmp_path / "others.safetensors"
    identity = pca_file(mine, 0)
    pca_file(others, 1)
    run = run_folder(tmp_path / "dc", "dc", [f"pca_{i}" for i in range(4)], pca=identity)
    with pytest.raises(RunError, match="give --pca"):
        load_planner(run)
    with pytest.raises(RunError, match="was trained with another PCA"):
        load_planner(run, others)
    planner = load_planner(run, mine)
    assert (planner.name, planner.knows_ground) == ("dc", False)
    assert planner.extractor.channels == 4


def test_a_ceiling_is_recognised_by_its_features(tmp_path):
    ceiling = load_planner(run_folder(tmp_path / "df", "df", GROUND_PROPERTIES))
    assert (ceiling.name, ceiling.knows_ground) == ("ceiling", True)
    with pytest.raises(RunError, match="cameras do not provide: mud, gravel"):
        load_planner(run_folder(tmp_path / "kinds", "df", ("mud", "gravel")))


def test_a_spread_is_loaded_with_its_model(tmp_path):
    folder = run_folder(tmp_path / "b", "b", [])
    assert load_planner(folder).spread is None
    spread = Spread(inputs_of(load_planner(folder).dynamics.vehicle, 0))
    save_beside_weights(folder / FILE, spread.state_dict())
    loaded = load_planner(folder).spread
    assert all(torch.equal(loaded.state_dict()[name], value) for name, value in spread.state_dict().items())
    save_tensors(folder / FILE, spread.state_dict(), weights_sha256="0" * 64)
    with pytest.raises(RunError, match="belongs to other weights"):
        load_planner(folder)


def test_a_run_that_never_saw_a_throttle_is_refused(tmp_path):
    vehicle = Vehicle(1150.0, 2.06, 0.5, ("brake", "steer"), ())
    folder = run_folder(tmp_path, "b", (), vehicle)
    with pytest.raises(RunError, match="without throttle, which a planner commands"):
        load_planner(folder)


def test_another_vehicle_is_described_and_a_similar_one_is_not():
    own = load_rig("proving_ground").vehicle
    same = Vehicle(1.05 * own.mass, own.wheelbase, own.max_steer, CONTROL, ())
    assert differing_vehicle(same, own) is None
    other = Vehicle(2 * own.mass, own.wheelbase, own.max_steer, CONTROL, ())
    assert differing_vehicle(other, own) == f"mass {2 * own.mass:.4g} kg, not {own.mass:.4g}"


@pytest.mark.parametrize(("make", "extractor"), [(parametric, None), (feature_model, extract_features)])
def test_a_warm_up_plans_with_any_model(monkeypatch, make, extractor):
    made, plan = [], Runtime._plan

    def keep(self, *given):
        plan(self, *given)
        made.append(self)

    monkeypatch.setattr(Runtime, "_plan", keep)
    model = make()
    before = {name: weights.clone() for name, weights in model.state_dict().items()}
    warm_up(model, sensor_setup(extractor), WHEELS, settings())
    assert made
    assert made[0].predictions
    assert not made[0].failures
    assert made[0].dropped == {}
    assert all(torch.equal(weights, before[name]) for name, weights in model.state_dict().items())


def test_a_warm_up_without_a_scan_is_refused():
    with pytest.raises(PlanningError, match=r"no plan was made on flat ground: .*; change the settings"):
        warm_up(parametric(), SensorSetup({}), WHEELS, settings())


RUN = "pretrained:proving-ground/dc"


@pytest.mark.parametrize("novelty", ["ignored", "missing"])
def test_codes_computed_on_a_gpu_equal_those_of_the_cpu(novelty):
    pixels = np.random.default_rng(0).integers(0, 256, (140, 280, 3), dtype=np.uint8)
    planner = load_planner(RUN, novelty=novelty)
    wanted = codes_of(pixels, planner.extractor.extract, planner.dynamics.encoder)
    with FromNumbers(), Faking():
        there = load_planner(RUN, novelty=novelty, device=str(GPU))
        encoder = encoder_on(str(GPU), there.dynamics.encoder)
        found = codes_of(pixels, there.extractor.extract, encoder)
        assert {part.device for part in encoder.state_dict().values()} == {GPU}
    assert {part.device for part in there.dynamics.state_dict().values()} == {torch.device("cpu")}
    np.testing.assert_allclose(found, wanted, atol=1e-4)
    assert (np.std(wanted, axis=(0, 1)) > 0.01).all() == (novelty == "ignored")  # noise looks like no ground
