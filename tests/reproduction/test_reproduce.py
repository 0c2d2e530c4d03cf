"""Both figures from synthetic drives: results, reports, resumption, refusals in one line."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from cli.command import refusal
from factories import circle_rows, stored_dataset
from feature_datasets import dataset_with_features
from log_messages import logged
from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.errors import RunError
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
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(settings, "CODES_SWEPT", (1, 4))
        return reproduced(tmp_path_factory.mktemp("reproduced"), dataset)


def finished(folder: Path) -> dict[Path, int]:
    """Runs and when they were written."""
    return {path: path.stat().st_mtime_ns for path in folder.glob("runs/*/model.json")}


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
    first = finished(folder)
    assert len(first) == 2
    reproduce(settings)
    second = finished(folder)
    with logged() as messages:
        reproduce(replace(settings, figure="fig4", processes=2))
    lines, last = [str(message) for message in messages], finished(folder)
    assert first.items() <= second.items() <= last.items()
    assert "[1/20] train b, seed 0: there" in lines
    done = re.compile(r"\[\d+/20\] train dc, seed [01]: done, .*; about .* left")
    assert sum(bool(done.fullmatch(line)) for line in lines) == 2
    assert {path.parent.name for path in last.keys() - second.keys()} == {"dc-0", "dc-1"}
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


def test_datasets_that_cannot_carry_a_figure_are_refused_in_one_line(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    stored_dataset(tmp_path / "blind", {"one": circle_rows(4000)}, "blocks:0.6,0.2,0.2")
    dataset_with_features(tmp_path / "few", ("train", "validation", "test"), rows=300)
    alone, cut = (Path(shutil.copytree(dataset, tmp_path / name)) for name in ("alone", "cut"))
    for drive in list(alone.glob("circle-[123]")):
        shutil.rmtree(drive)
    chunk = next(file for file in (cut / "circle-0" / "cells" / "features" / "c").rglob("*") if file.is_file())
    chunk.write_bytes(chunk.read_bytes()[:100])
    for name, why in {
        "blind": "no visual features by distance",
        "few": "fewer than a batch",
        "alone": "holds a single drive",
        "cut": "cut short",
        "nothing": "not a dataset",
    }.items():
        assert why in refusal(capsys, "reproduce", "fig4", "--dataset", tmp_path / name, "--out", tmp_path / "out")
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
