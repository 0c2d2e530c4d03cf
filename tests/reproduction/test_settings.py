"""Sizes, drives and models of the paper's figures."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feature_datasets import dataset_with_features
from offpiste.core.errors import OffpisteError, RunError
from offpiste.dataset.splits import PARTS, parse_split
from offpiste.reproduction.data import BLOCKS, MIX, planned_drives, rig_of, seconds_of
from offpiste.reproduction.settings import (
    SIZES,
    ReproductionSettings,
    compression_sizes,
    feature_numbers,
    figure_models,
    paper_name,
    sized,
    standard_model,
)
from offpiste.reproduction.steps import claim_folder
from offpiste.simulation.world.world import find_world_preset


@pytest.mark.parametrize("size", SIZES.values(), ids=list(SIZES))
def test_every_drive_has_a_world_and_a_seed_of_its_own(size):
    drives = planned_drives(size)
    assert len({drive.name for drive in drives}) == len(drives)
    assert len({drive.settings.world.seed for drive in drives}) == len(drives)
    assert {drive.part for drive in drives} == set(PARTS)
    for drive in drives:
        assert find_world_preset(drive.settings.world.preset) is not None
        assert size.shortest <= drive.settings.seconds <= size.longest
        assert drive.settings.sensors == size.sensors


def test_worlds_are_mixed_as_in_the_paper():
    size = SIZES["paper"]
    for part, total in zip(PARTS, size.seconds, strict=True):
        mine = [drive for drive in planned_drives(size) if drive.part == part]
        for world, share in MIX.items():
            seconds = seconds_of([drive for drive in mine if drive.settings.world.preset == world])
            assert seconds == pytest.approx(max(share * total, size.shortest), abs=0.5)
    assert sum(MIX.values()) == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["evening", "day"])
def test_large_sizes_have_worlds_of_their_own_and_all_speeds(name):
    size = SIZES[name]
    seeds = {drive.settings.world.seed for drive in planned_drives(size)}
    others = {drive.settings.seed for other in SIZES.values() if other is not size for drive in planned_drives(other)}
    assert not others & seeds
    assert min(seeds) > 12_000  # the seeds of experiments and courses
    assert all(drive.settings.driver.manoeuvres > 0 for drive in planned_drives(size))
    assert size.train.min_speed == 0
    assert "gear" in rig_of(size).channels


def test_drives_that_are_cut_have_all_parts():
    split = parse_split(BLOCKS)
    for drive in planned_drives(SIZES["smoke"], same_logs=True):
        place = np.zeros((round(drive.settings.seconds * 50), 2))
        assert set(PARTS) == {PARTS[p] for p in np.unique(split.label("", place)) if p >= 0}


def test_the_same_models_of_different_figures_are_one_run():
    assert compression_sizes(48)[4] == feature_numbers(48)[40] == standard_model("cf", 48)
    models = figure_models("fig3", 48)
    assert [member.label for member in models[:4]] == ["b", "b-hindsight", "df", "cf"]
    assert len(models) == 4 + 4 + 4
    assert {member.label for member in figure_models("fig4", 48)} == {"b", "b-hindsight", "df", "cf", "dc"}
    assert set(figure_models("fig4", 48)) - set(models) == {standard_model("dc", 48)}
    folders = [member.folder(0) for member in {*models, *figure_models("fig4", 48)}]
    assert len(set(folders)) == len(folders)
    assert standard_model("b", 48).folder(2) == "b-2"
    config = compression_sizes(48)[16].config(SIZES["laptop"], 0, "cpu")
    assert (config.model, config.codes, config.pca, config.epochs) == ("cf", 16, 40, SIZES["laptop"].train.epochs)


def test_models_are_shown_with_the_papers_letters():
    names = [paper_name(label) for label in ("b", "b-hindsight", "df", "cf (n=1)", "dc")]
    assert names == ["blind (B)", "B-hindsight", "DF", "CF (n=1)", "visual (DC)"]


@pytest.mark.parametrize(("stored", "numbers"), [(384, [5, 10, 20, 40, 80]), (6, [5, 6])])
def test_no_more_features_than_there_are(stored, numbers):
    swept = feature_numbers(stored)
    assert list(swept) == numbers
    assert all(member.pca == number for number, member in swept.items())
    assert standard_model("cf", stored).pca == min(40, stored)


def test_what_a_folder_is_of_does_not_depend_on_figure_processes_or_seeds(tmp_path: Path):
    one = ReproductionSettings("fig3", SIZES["smoke"], tmp_path, processes=1)
    for same in (replace(one, figure="fig4", processes=2), replace(one, size=sized("smoke", seeds=3))):
        assert one.described() == same.described()
    for other in (replace(one, contrast=0.5), replace(one, size=sized("smoke", (140.0, 40.0, 90.0)))):
        assert one.described() != other.described()


def test_a_size_with_other_lengths_and_seeds():
    other = sized("laptop", (1000.0, 100.0, 400.0), 1)
    assert (other.seconds, other.seeds, other.train) == ((1000.0, 100.0, 400.0), 1, SIZES["laptop"].train)
    for seconds in ((0.0, 1.0, 1.0), (1.0, float("nan"), 1.0), (1.0, 1.0, float("inf"))):
        with pytest.raises(OffpisteError, match="three above 0"):
            sized("smoke", seconds)
    with pytest.raises(OffpisteError, match="1 or more"):
        sized("smoke", seeds=0)


def test_a_dataset_is_known_by_its_content(tmp_path: Path):
    dataset_with_features(tmp_path / "one.zarr", rows=400)
    shutil.copytree(tmp_path / "one.zarr", tmp_path / "elsewhere.zarr")
    dataset_with_features(tmp_path / "other.zarr", rows=400, seed=1)
    one, same, other = (
        ReproductionSettings("fig4", SIZES["smoke"], tmp_path / "out", dataset=tmp_path / f"{name}.zarr")
        for name in ("one", "elsewhere", "other")
    )
    claim_folder(one.out, one.described())
    claim_folder(same.out, same.described())
    with pytest.raises(RunError, match=r"other settings \(dataset\)"):
        claim_folder(other.out, other.described())
