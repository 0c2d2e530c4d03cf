"""Which windows of a drive get the map of their start."""

from pathlib import Path

import numpy as np
import pytest

from factories import circle_rows, small_rig
from offpiste.dataset.extract import Job, _starts
from offpiste.dataset.splits import GAP, PARTS, parse_split

ROWS = 6000


@pytest.mark.parametrize("parts", [("validation", "test"), ("train", "validation"), ("test",)])
def test_windows_of_the_parts_that_are_asked_for(parts: tuple[str, ...]) -> None:
    split = parse_split("blocks:0.5,0.25,0.25")
    job = Job(Path("drive.mcap"), "drive", small_rig(), Path("d.zarr"), split)
    found = _starts(circle_rows(ROWS, seed=0, speed=5), job, parts)
    # Blocks end at 3000, 4500 and 6000; the first rows of all but the first block are the gap.
    edges = dict(zip(PARTS, ((0, 3000), (3000 + GAP, 4500), (4500 + GAP, ROWS)), strict=True))
    for starts, name in zip(found, parts, strict=True):
        first, last = edges[name]
        assert len(starts) == ROWS
        assert np.flatnonzero(starts)[[0, -1]].tolist() == pytest.approx([first + 10, last - 251], abs=5)
        assert starts.sum() > 100
