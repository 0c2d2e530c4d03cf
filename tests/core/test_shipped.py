"""Pretrained models."""

from pathlib import Path

import pytest

import offpiste
from offpiste.core.errors import RunError
from offpiste.core.shipped import PREFIX, names_apart, pretrained_names, run_folder
from offpiste.perception.pca import load_pca
from offpiste.runtime.planner import load_planner
from offpiste.training.file_check import check_paths

NAMES = pretrained_names()
SHIPPED_BYTES = 1_000_000


def test_the_models_of_the_proving_ground_ship():
    assert {f"proving-ground/{model}" for model in ("parametric", "b", "dc", "oracle")} <= {*NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_each_is_the_model_of_its_name_and_drives_without_further_files(name):
    run = offpiste.load(f"pretrained:{name}")
    assert run.model == {"oracle": "df"}.get(Path(name).name, Path(name).name)
    assert not Path(run.split.removeprefix("drives:")).is_absolute(), "no path of the training machine"
    planner = load_planner(Path(f"{PREFIX}{name}"))
    assert planner.dynamics.vehicle.control == ("throttle", "brake", "steer", "gear")
    assert (planner.extractor is not None) == (Path(name).name == "dc")
    assert planner.spread is not None


def test_features_of_known_ground_ship_too():
    load_planner(Path(f"{PREFIX}proving-ground/dc"), novelty="missing")
    with pytest.raises(RunError, match="reads no features, so --novelty has no effect"):
        load_planner(Path(f"{PREFIX}proving-ground/b"), novelty="missing")


def test_all_are_undamaged_and_small():
    assert check_paths([Path(f"{PREFIX}{name}") for name in NAMES]) == []
    folder = run_folder(f"{PREFIX}{NAMES[0]}").parent
    assert sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) < SHIPPED_BYTES


@pytest.mark.parametrize(
    ("load", "name", "said"),
    [
        (offpiste.load, "proving-ground/none", "did you mean 'proving-ground/b'. available: .*proving-ground/dc"),
        (offpiste.load, "../training", "available: .*proving-ground/dc"),
        (load_pca, "proving-ground/dc", "did you mean 'proving-ground'. available: proving-ground$"),
    ],
)
def test_an_unknown_name_lists_those_there_are(load, name, said):
    with pytest.raises(RunError, match=f"no pretrained (model|PCA) '{name}'; {said}"):
        load(f"pretrained:{name}")


def test_the_features_of_a_family_ship_under_its_name():
    assert load_pca("pretrained:proving-ground").identity == offpiste.load("pretrained:proving-ground/dc").pca


def test_names_of_runs_are_the_shortest_ends_of_paths_that_differ() -> None:
    for runs, names in (
        (["runs/dc", "runs/b"], ["dc", "b"]),
        (["s0/dc", "/elsewhere/s1/dc", "b"], ["s0/dc", "s1/dc", f"{Path.cwd().name}/b"]),
        (["runs/dc", f"{PREFIX}proving-ground/dc"], ["runs/dc", "proving-ground/dc"]),
        (["runs/dc", "runs/dc"], ["dc", "dc"]),
        ([], []),
    ):
        assert names_apart(runs) == names
