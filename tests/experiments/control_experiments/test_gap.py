"""Where the rest lies: shares that add up, from models of known errors, and their picture."""

import json
from dataclasses import asdict
from pathlib import Path

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from experiments.control_experiments.gap import PARTS, Bar, draw_gap, gap_control
from experiments.control_experiments.models import trained
from experiments.control_experiments.reproduced import open_reproduction
from feature_datasets import dataset_with_features
from offpiste.evaluation.errors import load_errors
from offpiste.reproduction.settings import Size
from offpiste.training.config import TrainConfig

SIZE = Size("tiny", (72.0, 18.0, 18.0), stride=320, train=TrainConfig(epochs=1, bicycle_epochs=1, batch=64, stride=80))


def test_shares_add_up_to_the_baselines_error(tmp_path: Path) -> None:
    folder = tmp_path / "reproduced"
    folder.mkdir()
    dataset_with_features(folder / "dataset.zarr")
    dataset_with_features(folder / "truth.zarr", seed=1)
    (folder / "settings.json").write_text(json.dumps({"size": asdict(SIZE), "dataset": "simulated"}))
    of = open_reproduction(folder)
    for model in ("b", "dc"):
        trained(of.dataset, of.member(model).config(of.size, 0, "cpu"), folder / "runs")
    page = gap_control(of, tmp_path / "controls", 1)
    bars = json.loads((page.parent / "control.json").read_text("utf-8"))["bars"]
    assert [bar["lookup"] for bar in bars] == ["10 m", "20 m", "30 m", "40 m", "map"]
    kept = {model: tmp_path / f"controls/evaluated/{model}-0" for model in ("b", "dc")}
    errors = {model: load_errors(next(folder.glob("map-*.safetensors"))) for model, folder in kept.items()}
    blind, seeing = (float(each.distance().mean()) for each in errors.values())
    assert bars[-1]["error_m"] == pytest.approx(blind)
    assert bars[-1]["gained"] == pytest.approx(1 - seeing / blind)
    for bar in bars:
        assert sum(bar[part] for part in PARTS) == pytest.approx(1)
    assert bars[-1]["distance"] == 0, "the map has no hindsight"
    assert (page.parent / "gap.png").exists()


def test_the_picture_stacks_what_is_above_zero() -> None:
    bar = Bar(lookup="10 m", error_m=2.0, rest=0.5, start=-0.1, features=0.3, distance=0.1, gained=0.2)
    figure = draw_gap([bar])
    FigureCanvasAgg(figure).draw()
    (axes,) = figure.axes
    heights = [patch.get_height() for patch in axes.patches]
    assert heights == pytest.approx([50, 0, 30, 10, 20])
    assert [text.get_text() for text in axes.texts] == ["50", "30", "10", "20"]
