"""A report figure of an extension, through the command line."""

from pathlib import Path

import numpy as np

from extending.outside import succeeded
from factories import circle_dataset, circle_rows
from offpiste.training.config import TrainConfig
from offpiste.training.train import train

QUICK = TrainConfig(model="parametric", epochs=1, bicycle_epochs=1, actuator_epochs=1, stride=50)


def test_the_report_has_the_figure_of_an_extension(tmp_path: Path) -> None:
    path, out, rows = tmp_path / "circles.zarr", tmp_path / "report", circle_rows(3000)
    rows.state_causal[:, 5] = np.linspace(0.1, 0.5, len(rows.state_causal))
    train(circle_dataset(path, rows, "blocks:0.4,0.2,0.4"), QUICK, tmp_path / "run")

    succeeded("evaluate", tmp_path / "run", "--dataset", path, "--out", out, extension="yaw_rate_figure")
    assert (out / "yaw_rate.png").read_bytes().startswith(b"\x89PNG")
    page = (out / "report.html").read_text("utf-8")
    assert "by the initial yaw rate; all bins hold equal numbers of windows.</figcaption>" in page
    headings = [part.partition("</h2>")[0] for part in page.split("<h2>")[1:]]
    assert headings[-3:] == ["Worst windows", "Error by yaw rate", "How to read this"]
    assert page.count("data:image/png;base64,") == page.count('<figure class="charts">') == 7
