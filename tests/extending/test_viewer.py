"""A viewer of an extension."""

from pathlib import Path

from extending.outside import succeeded

SCRIPT = """
import sys
import numpy as np
from offpiste.live.viewers import VIEWERS
from offpiste.runtime.estimator import VehicleReading

viewer = VIEWERS["pose-table"](sys.argv[1], np.zeros((4, 2)), ())
place = np.array((3.0, 4.5, 0.0))
viewer.pose(VehicleReading(1.5, place, np.array((0, 0, 0, 1.0)), np.zeros(3), 0.0, np.zeros(4)))
viewer.line("plan", 1.5, None)
viewer.mode(1.5, "driving", "")
viewer.close()
print(viewer.where)
"""


def test_it_is_found_by_its_name_and_shows_what_it_can(tmp_path: Path) -> None:
    table = tmp_path / "poses.csv"
    assert succeeded("-c", SCRIPT, table, extension="pose_table").strip() == str(table)
    assert table.read_text() == "time,x,y\n1.50,3.00,4.50\n"
