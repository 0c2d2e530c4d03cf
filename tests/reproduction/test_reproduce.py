"""Both figures from synthetic drives: results, reports, resumption, refusals in one line."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from factories import circle_rows, small_rig
from feature_datasets import dataset_with_features
from log_messages import logged
from offpiste.cli import main
from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.errors import RunError
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import add_drive, create
from offpiste.reproduction import runs as runs_module
from offpiste.reproduction import settings
from offpiste.reproduction.reproduce import reproduce
from offpiste.reproduction.settings import SIZES, ReproductionSettings, Size
from offpiste.training.config import TrainConfig

TINY = Size(
    "tiny", (30.0, 15.0, 15.0), seeds=2, stride=40, train=TrainConfig(epochs=1, bicycle_epochs=1, batch=64, stride=40)
)


class Killed(BaseException):
    """Stands in for a kill: nothing in the program catches it."""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return dataset_with_features(tmp_path_factory.mktemp("data") / "seen.zarr").path


@pytest.fixture(scope="module")
def out(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """fig3, killed on the way and begun again, then fig4 in the same folder."""
    folder = tmp_path_factory.mktemp("reproduced")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(settings, "CODES_SWEPT", (1, 4))
        return reproduced(folder, dataset)


def reproduced(folder: Path, dataset: Path) -> Path:
    settings = ReproductionSettings("fig3", TINY, folder, dataset=dataset, processes=1)
    real, trained = runs_module.train, []

    def killed_later(*arguments: object, **options: object) -> object:
        if len(trained) == 2:
            raise Killed
        trained.append(arguments)
        return real(*arguments, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs_module, "train", killed_later)
        with pytest.raises(Killed):
            reproduce(settings)
    kept = {path: path.stat().st_mtime_ns for path in folder.glob("runs/*/model.json")}
    assert len(kept) == 2
    reproduce(settings)
    assert all(path.stat().st_mtime_ns == time for path, time in kept.items())
    kept = {path: path.stat().st_mtime_ns for path in folder.glob("runs/*/model.json")}
    with logged() as messages:
        reproduce(replace(settings, figure="fig4", processes=2))
    lines = [str(message) for message in messages]
    assert all(path.stat().st_mtime_ns == time for path, time in kept.items())
    assert "[1/20] train b, seed 0: there" in lines
    done = re.compile(r"\[\d+/20\] train dc, seed [01]: done, .*; about .* left")
    assert sum(bool(done.fullmatch(line)) for line in lines) == 2
    assert {path.parent.name for path in folder.glob("runs/*/model.json")} - {p.parent.name for p in kept} == {
        "dc-0",
        "dc-1",
    }
    return folder


def metrics(out: Path, figure: str) -> dict:
    return json.loads((out / figure / "metrics.json").read_text("utf-8"), parse_constant=lambda name: pytest.fail(name))


def test_figures_have_their_models_lookups_and_coverage(out: Path) -> None:
    found = metrics(out, "fig4")
    readings = {(row["lookup"], row["feature_set"]) for row in found["results"] if row["model"] == "dc"}
    assert readings == {("map", None)} | {("recorded", name) for name in FEATURE_SETS}
    assert found["coverage"]["valid"][0] == pytest.approx(1.0)
    assert found["coverage"]["valid"][-1] == pytest.approx(0.2, abs=0.05)
    found = metrics(out, "fig3")
    variants = {"", "n=1"}
    rows = found["results"]
    assert {row["variant"] for row in rows if row["model"] == "cf"} == variants
    assert {row["model"] for row in rows} == {"b", "b-hindsight", "df", "cf"}
    assert {(row["lookup"], row["feature_set"]) for row in rows} == {("recorded", "hindsight"), ("map", None)}
    compared = {a["model"] + a["variant"] for a in found["against_b"]}
    assert compared == {"b-hindsight", "df"} | {f"cf{name}" for name in variants}


def test_relative_differences_are_those_of_the_means(out: Path) -> None:
    for figure in ("fig3", "fig4"):
        found = metrics(out, figure)
        at_end = {
            (row["model"] + row["variant"], row["lookup"], row["feature_set"]): row
            for row in found["results"]
            if row["horizon_s"] == 5.0 and row["seed"] is None
        }
        for against in (a for a in found["against_b"] if a["seed"] is None):
            reading = against["lookup"], against["feature_set"]
            mine, other = at_end[against["model"] + against["variant"], *reading], at_end["b", *reading]
            for key, value in against["relative"].items():
                assert value["mean"] == pytest.approx(mine[key]["mean"] / other[key]["mean"] - 1, abs=1e-9)
            assert against["n"] == mine["n"] == other["n"]


@pytest.mark.parametrize(("figure", "pictures"), [("fig3", 6), ("fig4", 5)])
def test_the_report_needs_nothing_but_itself(out: Path, figure: str, pictures: int) -> None:
    page = (out / figure / "report.html").read_text("utf-8")
    sources = re.findall(r'src="([^"]{0,30})', page)
    assert len(sources) == pictures
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert not re.search(r"https?://|<script[^>]* src|<link", page)
    assert "What the paper says" in page
    assert str(metrics(out, figure)["made"]["machine"].split(",")[0]) in page
    assert "the paper uses up to 80" in page
    assert "blind (B)" in page
    assert all(png.read_bytes().startswith(b"\x89PNG") for png in (out / figure).glob("*.png"))


def test_seeds_are_shown_and_their_stages_are_fitted_once(out: Path) -> None:
    runs = {path.parent.name for path in out.glob("runs/*/model.json")}
    assert runs == {f"{name}-{seed}" for name in ("b", "b-hindsight", "cf", "cf-n1", "dc", "df") for seed in range(2)}
    for seed in range(2):
        assert len({path.read_bytes() for path in out.glob(f"runs/*-{seed}/bicycle.safetensors")}) == 1
        lines = [path.read_text() for path in sorted(out.glob(f"runs/*-{seed}/metrics.jsonl"))]
        assert sum('"bicycle"' in text for text in lines) == 1
    single = [a for a in metrics(out, "fig4")["against_b"] if a["model"] == "dc" and a["seed"] is not None]
    assert {a["seed"] for a in single} == {0, 1}
    assert "<h2>Seeds</h2>" in (out / "fig4" / "report.html").read_text("utf-8")


def test_other_settings_in_the_same_folder_are_refused(out: Path, dataset: Path) -> None:
    settings = ReproductionSettings("fig3", TINY, out, dataset=dataset)
    for other, named in (
        (replace(settings, size=replace(settings.size, stride=50)), "size.stride"),
        (replace(settings, dataset=None), "dataset"),
    ):
        with pytest.raises(RunError, match=named):
            reproduce(other)


def command(*words: object, capsys: pytest.CaptureFixture) -> str:
    with pytest.raises(SystemExit) as exit_:
        main(["reproduce", *map(str, words)])
    assert exit_.value.code == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1, error
    return error


def test_datasets_that_cannot_carry_a_figure_are_refused_in_one_line(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    blind = tmp_path / "blind.zarr"
    create(blind, small_rig(), parse_split("blocks:0.6,0.2,0.2"))
    add_drive(blind, "one", circle_rows(4000), parse_split("blocks:0.6,0.2,0.2"), ())
    few = tmp_path / "few.zarr"
    dataset_with_features(few, ("train", "validation", "test"), rows=300)
    alone = tmp_path / "alone.zarr"
    shutil.copytree(dataset, alone)
    for drive in list(alone.glob("circle-[123]")):
        shutil.rmtree(drive)
    cut = tmp_path / "cut.zarr"
    shutil.copytree(dataset, cut)
    chunk = next((cut / "circle-0" / "cells" / "features" / "c").rglob("0"))
    while chunk.is_dir():
        chunk = chunk / "0"
    chunk.write_bytes(chunk.read_bytes()[:100])
    for path, why in {
        blind: "no visual features by distance",
        few: "fewer than a batch",
        alone: "holds a single drive",
        cut: "cut short",
        tmp_path / "nothing": "not a dataset",
    }.items():
        error = command("fig4", "--dataset", path, "--out", tmp_path / "out", capsys=capsys)
        assert why in error, error
    assert not (tmp_path / "out").exists(), "a folder that cannot be filled is not begun"


def test_every_size_can_be_started(tmp_path: Path) -> None:
    from offpiste.simulation import simulate

    class Begun(BaseException):
        pass

    def begin(*arguments: object, **settings: object) -> None:
        raise Begun

    for name, size in SIZES.items():
        with pytest.MonkeyPatch.context() as patch, logged() as messages:
            patch.setattr(simulate, "run_all", begin)
            with pytest.raises(Begun):
                reproduce(ReproductionSettings("fig3", size, tmp_path / name))
        assert re.match(r"\[1/\d+\] simulate \d+ drives", str(messages[0]))


def test_a_damaged_file_of_errors_is_named(out: Path, dataset: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    file = copy / "runs" / "b-0" / "errors" / "map.safetensors"
    file.write_bytes(file.read_bytes()[:50])
    with pytest.raises(RunError, match=r"map\.safetensors"):
        reproduce(ReproductionSettings("fig4", TINY, copy, dataset=dataset))
