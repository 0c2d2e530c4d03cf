"""Evaluation of models with known errors, and the report of it."""

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch
from matplotlib.figure import Figure

from factories import COMMANDED, circle_rows, stored_dataset
from feature_datasets import dataset_with_features, with_snapshots
from offpiste.core.conventions import DT
from offpiste.core.errors import RunError
from offpiste.dataset.resample import Rows
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import Dataset
from offpiste.dynamics import MODELS, ConstantMotion, Dynamics, Kinematic, Parametric
from offpiste.evaluation.evaluate import EvaluatedModel, Evaluation, by_split, evaluate_models, named_apart, readings_of
from offpiste.evaluation.intervals import Sampling
from offpiste.evaluation.metrics import ResultRow, pooled_rows, run_rows
from offpiste.evaluation.report import draw_figures, report_page, terminal_table, write_report
from offpiste.evaluation.report_figures import REPORT_FIGURES, ReportFigure
from offpiste.evaluation.report_figures.windows import draw_typical, draw_worst, path_line
from offpiste.training.run import vehicle_of
from window_errors import changed

SCALE = torch.ones(5)
QUICK = {"scale": SCALE, "stride": 100, "sampling": Sampling(block_seconds=6.0)}


def winding(rows: int, seed: int = 0) -> Rows:
    """A drive with steering that changes, on ground that rises and falls."""
    flat = circle_rows(rows, seed=seed)
    t = DT * np.arange(rows)
    yaw_rate = 0.3 * np.sin(0.4 * t + seed)
    yaw = np.cumsum(yaw_rate) * DT
    place = np.cumsum(5 * DT * np.stack((np.cos(yaw), np.sin(yaw)), axis=1), axis=0)
    state = np.column_stack((place, yaw, np.full(rows, 5.0), np.zeros(rows), yaw_rate))
    slope = 0.1 * np.sin(0.3 * t)
    normal = np.stack((-slope * np.cos(yaw), -slope * np.sin(yaw), np.ones(rows)), axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    control = np.stack((np.full(rows, 0.3), np.zeros(rows), np.arctan(2.2 * yaw_rate / 5) / 0.4), axis=1)
    noise = np.random.default_rng(seed).normal(0, 0.01, state.shape)
    return replace(
        flat,
        state=state.astype(np.float32),
        state_causal=(state + noise).astype(np.float32),
        control=control.astype(np.float32),
        control_causal=control.astype(np.float32),
        normal=np.repeat(normal[None, :, None], 4, axis=2).astype(np.float32),
        normal_causal=normal.astype(np.float32),
    )


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    drives = {"<first>": winding(3600), "second": winding(3000, seed=1)}
    return stored_dataset(tmp_path_factory.mktemp("data") / "small.zarr", drives, "blocks:0.2,0.2,0.6")


def slipping(share: float) -> Dynamics:
    """`kinematic` that is too slow by a share of its speed."""
    lag = torch.tensor([share, share, 0, 0, 0, 0])
    return changed(Kinematic, lambda moved, before, step: moved - lag * (moved - before))


@pytest.fixture(scope="module")
def evaluation(dataset: Dataset) -> Evaluation:
    models = [EvaluatedModel("slow", slipping(share), seed=seed) for seed, share in enumerate((0.1, 0.3))]
    return evaluate_models(
        [*models, EvaluatedModel("parametric", Parametric(COMMANDED))], dataset, **QUICK, command="x < y"
    )


def row(rows: list[ResultRow], model: str, start: str = "smoothed", lookup: str | None = None, **others) -> ResultRow:
    wanted = {"model": model, "start": start, "lookup": lookup, "horizon_s": 5.0, "seed": None, **others}
    (found,) = [r for r in rows if all(getattr(r, key) == value for key, value in wanted.items())]
    return found


def test_every_model_start_lookup_and_horizon_has_a_row(evaluation: Evaluation) -> None:
    rows = pooled_rows(evaluation.metrics.results)
    readings = {(r.model, r.start, r.lookup) for r in rows}
    lookups = {("ctrv", None), ("kinematic", None)}
    lookups |= {(model, lookup) for model in ("slow", "parametric") for lookup in ("recorded", "map")}
    assert readings == {(model, start, lookup) for start in ("causal", "smoothed") for model, lookup in lookups}
    assert len(rows) == 5 * len(readings)
    assert {r.horizon_s for r in rows} == {1.0, 2.0, 3.0, 4.0, 5.0}
    assert len({r.n for r in rows}) == 1, "the same windows for every model"
    assert {r.seed for r in run_rows(evaluation.metrics.results)} == {0, 1}
    text = terminal_table(evaluation.metrics.results).text(width=200)
    assert (text.count("│ slow"), text.count("│ kinematic")) == (4, 2), "a line per start and lookup"


def test_a_known_difference_is_found_with_its_sign(evaluation: Evaluation) -> None:
    """10 and 30 % of 25 m are lost: about 2.5 and 7.5 m, 5 m on average; the kinematic bicycle is all but right."""
    rows = evaluation.metrics.results
    assert row(rows, "kinematic").distance_error_m.mean < 0.3
    slow = row(rows, "slow", lookup="map")
    assert slow.distance_error_m.mean == pytest.approx(5.0, rel=0.08)
    assert row(rows, "slow", lookup="map", seed=0).distance_error_m.mean == pytest.approx(2.5, rel=0.08)
    assert row(rows, "slow", lookup="map", seed=1).distance_error_m.mean == pytest.approx(7.5, rel=0.08)
    minus = slow.minus["kinematic"]
    assert minus.distance_error_m.mean == pytest.approx(5.0, rel=0.08)
    assert np.isnan(minus.distance_error_m.ci95).all(), "too few drives"
    assert row(rows, "kinematic").minus["slow"].distance_error_m.mean == -minus.distance_error_m.mean
    assert minus.loss.mean > 0


def test_numbers_of_the_windows(evaluation: Evaluation, dataset: Dataset) -> None:
    found = evaluation.metrics.windows
    assert found.n == len(evaluation.windows.start_speed)
    assert (found.drives, found.stride_s, found.block_s) == (2, 2.0, 6.0)
    assert found.median_distance_m == pytest.approx(25.0, abs=0.1)
    assert found.median_speed_mps == pytest.approx(5.0, abs=0.1)
    assert found.blocks >= 6


def test_worst_windows_do_not_overlap_and_show_every_run(evaluation: Evaluation) -> None:
    assert evaluation.shown.reading_label == "slow · map"
    panels = draw_worst(evaluation).panels
    found = [re.fullmatch(r"error (.*) m\n.* m/s, heading .*°\n(.*), at (.*) s", panel.title) for panel in panels]
    errors = [float(match[1]) for match in found]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] == pytest.approx(evaluation.errors[evaluation.shown].distance().max(), abs=0.005)
    for i, (panel, match) in enumerate(zip(panels, found, strict=True)):
        _, recorded, *predicted, start = panel.lines
        assert [line.label for line in predicted][-2:] == ["slow", "slow"], "the first model lies on top"
        assert sorted(line.label for line in predicted[:-2]) == ["ctrv", "kinematic", "parametric"]
        assert (start.marker, start.x, start.y) == ("^", 0, 0)
        assert all(abs(float(match[3]) - float(m[3])) > 5.2 for m in found[i + 1 :] if m[2] == match[2])
        ends = [np.hypot(line.x[-1] - recorded.x[-1], line.y[-1] - recorded.y[-1]) for line in predicted[-2:]]
        assert np.mean(ends) == pytest.approx(errors[i], abs=0.01)
        assert (recorded.x[1], recorded.y[1]) == pytest.approx((0.0, 5 * DT), abs=0.05), "ahead is up"


def test_typical_windows_show_the_driven_path_if_there_are_no_features(evaluation: Evaluation) -> None:
    panels = draw_typical(evaluation).panels
    notes = [panel.title.partition(":")[0] for panel in panels]
    assert list(dict.fromkeys(notes)) == ["lower quartile", "median", "upper quartile"]
    for panel in panels:
        driven, recorded = panel.lines[:2]
        assert panel.raster is None
        assert panel.y_range[0] < recorded.y.min() < recorded.y.max() < panel.y_range[1]
        away = np.hypot(driven.x[:, None] - recorded.x[::50], driven.y[:, None] - recorded.y[::50])
        assert np.nanmin(away, axis=0).max() < 0.6, "the drive passed along the recorded path"


def test_a_failed_prediction_is_drawn_up_to_the_failure() -> None:
    recorded = np.stack((np.linspace(0.1, 25, 250), np.linspace(0, 2, 250)), axis=1)
    failed = 0.9 * recorded
    assert path_line("blind", "#0072b2", failed, recorded).hover[-1] == (
        f"blind after 5.0 s\n{0.1 * np.hypot(25, 2):.2f} m from the recorded position"
    )
    failed[100:] = np.nan
    assert path_line("blind", "#0072b2", failed, recorded).hover[-1].startswith("blind after 2.0 s\n")


def test_the_report_is_self_contained_and_escapes(evaluation: Evaluation, tmp_path: Path) -> None:
    write_report(evaluation, tmp_path / "report")
    pictures = {f"{name}.png" for name in ("box", "distribution", "growth", "speed", "typical", "worst")}
    files = {file.name for file in (tmp_path / "report").iterdir()}
    assert files == pictures | {"metrics.json", "report.html"}
    text = (tmp_path / "report" / "report.html").read_text("utf-8")
    without = re.sub(r'(id="plotly">|base64,)[^"<]*', "", text)
    assert not re.search(r"https?://|[^:]//[a-z]+\.|@import|url\(|<link|<iframe|<script[^>]* src", without)
    assert text.count('<script type="application/json">') == 6, "every figure has charts"
    assert text.count('src="') == text.count('src="data:image/png;base64,') == 6
    assert "x &lt; y" in text
    assert "x < y" not in text
    content = json.loads((tmp_path / "report" / "metrics.json").read_bytes(), parse_constant=pytest.fail)
    assert content == json.loads(msgspec.json.encode(evaluation.metrics), parse_constant=pytest.fail)
    assert content["results"][0]["distance_error_m"]["ci95"] == [None, None], "too few drives"


def test_figures_stand_in_their_sections_and_one_with_nothing_to_draw_is_left_out(evaluation, monkeypatch) -> None:
    added = {"none": ReportFigure("Nothing", "", lambda evaluation: None)}
    added["one"] = ReportFigure("Distribution", "a caption", lambda evaluation: Figure())
    added["two"] = ReportFigure("Something else", "another", lambda evaluation: Figure())
    monkeypatch.setattr(REPORT_FIGURES, "_entries", added)
    page = report_page(evaluation.metrics, draw_figures(evaluation))
    shown = {section.heading: [picture.name for picture in section.pictures] for section in page.sections}
    assert shown["Distribution"] == ["one"]
    assert list(shown)[-2:] == ["Something else", "How to read this"]
    assert "Nothing" not in shown
    assert "Worst windows" not in shown, "a heading without a table or a figure"


def test_a_model_that_diverges_is_counted_as_failed_once_for_each_run(dataset: Dataset, tmp_path: Path) -> None:
    diverging = changed(ConstantMotion, lambda moved, before, step: moved * 1e3)
    runs = [EvaluatedModel("b", diverging, seed=seed) for seed in (0, 1)]
    found = evaluate_models(runs, dataset, **QUICK, starts=("causal",), lookups=("map",))
    broken = row(found.metrics.results, "b", "causal", "map")
    assert broken.n_failed == broken.n == found.metrics.windows.n
    assert broken.distance_error_m.mean == np.inf
    write_report(found, tmp_path)
    content = json.loads((tmp_path / "metrics.json").read_bytes(), parse_constant=pytest.fail)
    assert {r["model"]: r["distance_error_m"]["mean"] for r in content["results"]}["b"] is None
    text = (tmp_path / "report.html").read_text("utf-8")
    assert f"{broken.n} ({broken.n} failed)" in text
    assert f"{2 * broken.n} predictions are not finite" in text
    assert "blind · map" in text
    assert "blind (b): parametric" in text


def test_folds_cover_every_window_once_and_all_together(dataset: Dataset) -> None:
    def fold(number: int, share: float, seed: int) -> EvaluatedModel:
        return EvaluatedModel("b", slipping(share), seed=seed, fold=number, split=parse_split(f"fold:{number}/3"))

    models = [fold(number, 0.1 * (number + 1), seed) for number in range(3) for seed in (0, 1)]
    found = evaluate_models(models, dataset, **QUICK, starts=("smoothed",), lookups=("map",))
    rows = found.metrics.results
    together = row(rows, "b", lookup="map", fold=None)
    folds = [row(rows, "b", lookup="map", fold=number, seed=0) for number in range(3)]
    assert together.n == sum(f.n for f in folds) == row(rows, "kinematic", fold=None).n
    for number, one in enumerate(folds):
        assert one.distance_error_m.mean == pytest.approx(2.5 * (number + 1), rel=0.08)
    weighted = sum(f.n * f.distance_error_m.mean for f in folds) / together.n
    assert together.distance_error_m.mean == pytest.approx(weighted)
    assert row(rows, "kinematic", fold=1).n == folds[1].n, "baselines are evaluated fold by fold, too"
    assert found.metrics.split == "fold:0/3, fold:1/3, fold:2/3"


def test_models_of_different_splits_and_repeated_runs_are_refused(dataset: Dataset) -> None:
    folded = EvaluatedModel("b", ConstantMotion(COMMANDED), fold=0, split=parse_split("fold:0/3"))
    with pytest.raises(RunError, match="has no run for split"):
        evaluate_models([folded, EvaluatedModel("parametric", Parametric(COMMANDED))], dataset, **QUICK)
    twice = [EvaluatedModel("b", ConstantMotion(COMMANDED), seed=0)] * 2
    with pytest.raises(RunError, match="same seed and fold"):
        evaluate_models(twice, dataset, **QUICK)


def test_flat_ground_has_nothing_to_look_up_and_short_parts_no_interval(tmp_path: Path) -> None:
    flat = stored_dataset(tmp_path / "flat.zarr", {"circle": circle_rows(3000)}, "blocks:0.4,0.2,0.4")
    found = evaluate_models([], flat, **QUICK)
    assert {(r.model, r.lookup) for r in found.metrics.results} == {("ctrv", None), ("kinematic", None)}
    assert np.isnan(row(found.metrics.results, "ctrv").distance_error_m.ci95).all()
    write_report(found, tmp_path / "report")


FOLDS = [parse_split(f"fold:{number}/3") for number in range(3)]


@pytest.fixture(scope="module")
def snapped(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Maps as they were at some windows of every drive, and no other maps."""
    folder = tmp_path_factory.mktemp("data")
    parts = ("train", "validation", "test")
    whole = dataset_with_features(folder / "seen.zarr", parts, rows=3300, speeds=(2.5, 3.0))
    kept = with_snapshots(whole, folder / "snapshots", [300, 600, 900])
    return replace(kept, drives=tuple(replace(drive, load_map=None) for drive in kept.drives))


def parametric(dataset: Dataset, folds: bool) -> Sequence[EvaluatedModel]:
    dynamics = MODELS["parametric"](vehicle_of(dataset), seed=0)
    if not folds:
        return [EvaluatedModel("parametric", dynamics)]
    return [EvaluatedModel("parametric", dynamics, fold=n, split=split) for n, split in enumerate(FOLDS)]


def test_folds_of_a_dataset_with_snapshots_are_evaluated_at_recorded_places(snapped: Dataset, caplog) -> None:
    caplog.set_level("INFO")
    settings = {"scale": torch.ones(5), "starts": ("causal",), "stride": 50}
    found = evaluate_models(parametric(snapped, folds=True), snapped, **settings)
    assert {row.lookup for row in found.metrics.results if row.model == "parametric"} == {"recorded"}
    assert "not evaluated on the map: windows of the split fold:0/3, fold:1/3, fold:2/3 have no map" in caplog.text
    assert found.windows.usual_step(0) == 50, "none is evaluated on its few windows with a snapshot instead"
    (group,) = by_split(parametric(snapped, folds=False), snapped)
    assert readings_of([group[0]], "test", ("recorded", "map"), ("10",)) == [("recorded", "10"), ("map", None)]
    datasets = [each for each, _ in by_split(parametric(snapped, folds=True), snapped)]
    assert readings_of(datasets, "test", ("map",), ("10",)) == [("recorded", "10")]


@pytest.mark.parametrize(
    ("runs", "labels"),
    [
        ({"runs/b": 0, "runs/b-longer": 0}, ["b", "b (b-longer)"]),
        ({"b-0": 0, "b-1": 1, "long-0": 0, "long-1": 1}, ["b", "b", "b (long)", "b (long)"]),
        ({"s/b": 0, "t/b": 0}, ["b (s/b)", "b (t/b)"]),
        ({"b": 0, "b-0": 0}, ["b", "b (b-0)"]),
    ],
)
def test_runs_of_one_seed_are_named_by_their_folders(runs: dict[str, int], labels: list[str]) -> None:
    dynamics = MODELS["b"](COMMANDED, seed=0)
    models = [EvaluatedModel("b", dynamics, seed=seed) for seed in runs.values()]
    found = named_apart([*models, EvaluatedModel("parametric", dynamics, seed=0)], [*map(Path, runs), Path("b")])
    assert [model.label for model in found] == [*labels, "parametric"]


def test_folds_of_one_cross_validation_share_a_name() -> None:
    dynamics = MODELS["b"](COMMANDED, seed=0)
    folds = [EvaluatedModel("b", dynamics, seed=0, fold=n, split=split) for n, split in enumerate(FOLDS)]
    labels = [model.label for model in named_apart([*folds, *folds], [Path("cv")] * 3 + [Path("cv2")] * 3)]
    assert labels == 3 * ["b (cv)"] + 3 * ["b (cv2)"]
