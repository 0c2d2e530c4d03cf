"""What `offpiste drive` refuses, and the tables that it prints."""

from io import StringIO
from pathlib import Path

import pytest
import torch
from rich.console import Console

from offpiste.cli.drive import Drive
from offpiste.closed_loop.command import modes_table, stages_table
from offpiste.core.errors import PlanningError


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_not_there_is_refused_before_a_world_is_built(tmp_path, monkeypatch):
    monkeypatch.setattr("offpiste.closed_loop.command.drive_course", None)
    with pytest.raises(PlanningError, match="no GPU 'cuda' for planning"):
        Drive(Path("pretrained:proving-ground/b"), device="cuda", out=tmp_path / "drive").run()


def test_tables_have_their_units():
    took = {"count": 3, "median_ms": 1.5, "p95_ms": 2.5, "total_s": 0.1}
    result = {"stages": {"plan": took}, "modes": [(0.3, "driving", "")]}
    console = Console(width=100, file=StringIO())
    console.print(stages_table(result))
    console.print(modes_table(result))
    text = console.file.getvalue()
    assert all(unit in text for unit in ("median [ms]", "95 % [ms]", "all [s]", "at [s]"))
