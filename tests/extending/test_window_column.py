"""A column of the windows from outside the package: from a log's channel to a batch."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from offpiste.dataset.columns import COLUMNS, Column
from offpiste.errors import DatasetError, RigError
from offpiste.rig.rig import parse_rig

FOLDER = Path(__file__).parents[2] / "examples" / "extending"

RIG = """
name = "warm"
absent = ["brake_pressure", "steer_angle", "steer_rate", "engine_rpm"]
[vehicle]
mass = 800.0
max_steer = 0.4
pose_point = "the rear axle"
wheel_positions = [[2.2, 0.6], [2.2, -0.6], [0.0, 0.6], [0.0, -0.6]]
[channels]
position = { fields = ["x", "y"] }
yaw = { fields = ["yaw"] }
throttle = { fields = ["throttle"] }
brake = { fields = ["brake"] }
steer = { fields = ["steer"] }
temperature = { fields = ["air"], unit = "degC" }
"""

GATHER = """
import sys
import numpy as np
from offpiste.dataset.store import open_dataset
from offpiste.dataset.windows import Windows

dataset = open_dataset(sys.argv[1])
windows = Windows(dataset, "train")
batch = windows.gather(np.arange(len(windows)))
time, row = dataset.drives[0].rows.time, windows.rows
np.testing.assert_allclose(batch.extra["temperature"]["start"], 20 + 0.1 * time[row], atol=1e-4)
np.testing.assert_allclose(batch.history.extra["temperature"][:, 0], 20 + 0.1 * time[row - 10], atol=1e-4)
assert list(batch.extra["temperature"]) == ["past", "start"]
assert dataset.drives[0].rows.cut(slice(5, 9)).column("temperature").shape == (4,)
print(len(windows), "windows")
"""


def run(tmp_path: Path, *words: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join((str(FOLDER), os.environ.get("PYTHONPATH", "")))
    return subprocess.run(
        (sys.executable, *words),
        env=os.environ | {"PYTHONPATH": path, "OFFPISTE_EXTENSIONS": "temperature"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def test_an_added_column_goes_from_the_log_into_batches(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    time = np.arange(0, 10, 0.02)
    zero, air = 0 * time, 20 + 0.1 * time
    columns = {"t": time, "x": 5 * time, "y": zero, "yaw": zero, "throttle": zero, "brake": zero, "steer": zero}
    table = np.column_stack([*columns.values(), air])
    header = ",".join((*columns, "air"))
    np.savetxt(tmp_path / "drive.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    words = ("extract", "drive.csv", "--rig", "rig.toml", "--out", "d.zarr", "--split", "blocks:1,0,0")
    extracted = run(tmp_path, "-m", "offpiste", *words)
    assert extracted.returncode == 0, extracted.stderr
    gathered = run(tmp_path, "-c", GATHER, "d.zarr")
    assert gathered.returncode == 0, gathered.stderr
    assert int(gathered.stdout.split()[0]) > 100


def test_without_the_extension_the_channel_is_refused():
    with pytest.raises(RigError, match="unknown channel 'temperature'"):
        parse_rig(RIG, where="rig.toml")


def test_a_column_of_a_taken_name_is_refused():
    with pytest.raises(DatasetError, match="two columns called 'state'"):
        COLUMNS.register("state")(Column(read=lambda grid: grid.time))
