"""A tracked vehicle of an extension: its log, its model and a prediction."""

from pathlib import Path

import numpy as np

from extending.outside import offpiste, succeeded
from offpiste.core.conventions import DT

RIG = """
name = "tracked"
absent = ["throttle", "brake", "steer", "brake_pressure", "steer_angle", "steer_rate", "engine_rpm"]
[vehicle]
mass = 900.0
pose_point = "between the tracks"
wheel_positions = [[0.8, 0.7], [0.8, -0.7], [-0.8, 0.7], [-0.8, -0.7]]
[channels]
position = { fields = ["x", "y"] }
yaw = { fields = ["yaw"] }
left_track = { fields = ["left"], unit = "km/h", scale = 3.6 }
right_track = { fields = ["right"] }
"""

PREDICT = """
import sys
import numpy as np
from offpiste.dataset.store import open_dataset
from offpiste.dataset.windows import Windows
from offpiste.training.run import load_run
from offpiste.training.prediction import predict_batch

dataset, run = open_dataset(sys.argv[1]), load_run(sys.argv[2])
assert run.dynamics.vehicle.control_columns[-2:] == ("left_track", "right_track")
assert abs(run.dynamics.vehicle.track - 1.4) < 1e-9
windows = Windows(dataset, "test")
batch = windows.gather(windows.every(50))
predicted = predict_batch(run.dynamics, batch).state
print(float((predicted - batch.target)[:, -1, :2].norm(dim=-1).mean()))
"""


def drive(folder: Path, seconds: float = 60.0) -> Path:
    """A table of a vehicle that goes at 0.9 of its tracks' speed and turns at 0.6 of what they ask for."""
    time = np.arange(0, seconds, DT)
    left = 4 + np.sin(0.5 * time) + 0.5 * np.sin(1.3 * time)
    right = 4 + np.sin(0.7 * time + 1)
    speed, turn = 0.9 * (left + right) / 2, 0.6 * (right - left) / 1.4
    yaw = np.concatenate(([0.0], np.cumsum(turn * DT)[:-1]))
    x, y = (np.cumsum(speed * part * DT) for part in (np.cos(yaw), np.sin(yaw)))
    path = folder / "drive.csv"
    table = np.column_stack((time, x, y, yaw, left, right))
    np.savetxt(path, table, delimiter=",", header="t,x,y,yaw,left,right", comments="", fmt="%.9g")
    return path


def test_a_model_with_controls_of_its_own_is_trained_and_predicts(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    log, dataset, run = drive(tmp_path), tmp_path / "d.zarr", tmp_path / "run"
    inspected = offpiste("inspect", log, "--rig", tmp_path / "rig.toml", extension="skid_steer")
    assert "no control" not in inspected.stdout + inspected.stderr
    assert inspected.returncode == 0, inspected.stdout
    split = ("--split", "blocks:0.4,0.3,0.3")
    succeeded("extract", log, "--rig", tmp_path / "rig.toml", "--out", dataset, *split, extension="skid_steer")
    config = ("--model", "skid-steer", "--epochs", "3", "--batch", "16", "--stride", "25")
    succeeded("train", dataset, "--out", run, *config, extension="skid_steer")
    error = float(succeeded("-c", PREDICT, dataset, run, extension="skid_steer"))
    assert error < 3, "of 18 m driven in 5 s; constant motion is 12 m off"
