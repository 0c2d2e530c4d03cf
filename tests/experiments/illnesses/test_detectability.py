"""What healthy logs scatter by against what an error shifts, by hand; the study's command on a drive."""

import numpy as np
import pytest

from experiments.illnesses.detectability import Detectability, warned
from experiments.illnesses.effect import MANY
from experiments.illnesses.true_drive import save
from made_up_drive import made_up_drive


def test_an_error_as_large_as_the_scatter_warns_as_many_as_it_finds():
    # Healthy values are evenly spread over -1..1; an error of 0 changes nothing.
    healthy = np.linspace(-1, 1, 201)
    assert warned(healthy, (0.0,), found=0.5) == pytest.approx(0.5, abs=0.01)
    # Shifted by 1, distances are evenly spread over 0..2: half of them lie beyond 1, a tenth below 0.2.
    assert warned(healthy, (-1.0, 1.0), found=0.5) == pytest.approx(0, abs=0.01)
    assert warned(healthy, (-1.0, 1.0), found=0.9) == pytest.approx(0.8, abs=0.01)


def test_the_command_reports_and_resumes(tmp_path):
    (tmp_path / "drives").mkdir()
    for seed in (1, 2):
        save(made_up_drive(seconds=60, seed=seed), tmp_path / "drives" / f"drive-{seed:06d}.npz")
    settings = Detectability(out=tmp_path / "out", cache=tmp_path / "drives", drives=2, seed=1)
    text = settings.run()
    assert text == (tmp_path / "out" / "report.md").read_text()
    assert "What 2 drives can show" in text
    for row in ("steer: offset 0.02", "throttle: clipped, 0.5", f"| {MANY} |"):
        assert row in text
    made = (tmp_path / "out" / "measured.jsonl").read_bytes()
    assert settings.run() == text
    assert (tmp_path / "out" / "measured.jsonl").read_bytes() == made
