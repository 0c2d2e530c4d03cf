"""A page in a browser: its charts are drawn without a network. Skipped where there is no Chromium."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from offpiste.report.chart import Chart, Line, Panel
from offpiste.report.page import Page, Picture, Section, write_page

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
HEADLESS = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking")
HEADLESS += ("--disable-component-update", "--disable-sync", "--disable-quic", "--virtual-time-budget=20000")


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
@pytest.mark.parametrize("width", [500, 1600])
def test_charts_replace_pictures_and_fit_the_window(tmp_path: Path, width: int) -> None:
    x = np.linspace(0, 1, 20)
    panel = Panel("x [m]", "y [m]", [Line("a <b>", x, x, "#0072b2"), Line("c", x, 1 - x, "#d55e00")])
    pictures = [Picture(name, b"\x89PNG", name, Chart([panel] * n)) for n, name in ((1, "one"), (2, "two"))]
    write_page(Page("t", ["first"], {}, [Section("s", pictures=pictures)]), tmp_path)
    assert CHROMIUM is not None
    command = [CHROMIUM, *HEADLESS, f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={width},3000"]
    command += ["--dump-dom", (tmp_path / "report.html").as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    page = done.stdout.partition('id="plotly"')[0]
    assert 'data-drawn="3"' in page, done.stderr
    assert "<img" not in page
    assert page.count('aria-pressed="true"') == 2, "a button for each model, for the charts side by side"
    widths = [float(text) for text in re.findall(r'<svg class="main-svg"[^>]* width="([\d.]+)"', page)]
    assert len(widths) >= 3
    assert max(widths) <= width
