"""An actuator from outside the package: from a log's channel through a model's lag to its prediction."""

import numpy as np

from extending.outside import offpiste, python

RIG = """
name = "lagging"
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
throttle_position = { fields = ["flap"], unit = "percent" }
"""

ROLL_OUT = """
import sys
from dataclasses import replace
import torch
from offpiste.dataset.store import open_dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import MODELS
from offpiste.dynamics.inputs import drive_train
from offpiste.training.run import vehicle_of
from offpiste.training.prediction import predict

dataset = open_dataset(sys.argv[1])
vehicle = vehicle_of(dataset)
assert vehicle.actuators == ("throttle_position",)
assert vehicle.actuator_columns == ("brake", "steer", "steer_rate", "engine_rpm", "throttle_position")
windows = Windows(dataset, "train")
batch = windows.gather(windows.every(50))
train = drive_train(vehicle, batch.state, batch.actuators, batch.control[:, 0])
torch.testing.assert_close(train.throttle, batch.actuators[:, 4])
for name in ("parametric", "b"):
    model = MODELS[name](vehicle)
    rate = model.actuators.constant_names.index(("throttle", "rate"))
    model.actuators.raw.data[rate] = torch.logit(torch.tensor(1.9 / 39.9))  # 2 / s
    predicted = predict(model, batch).actuators[..., 4]
    torch.testing.assert_close(predicted, batch.target_actuators[..., 4], atol=0.02, rtol=0)
print(len(batch.state))
"""


def test_an_added_actuator_lags_behind_its_command(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    time = np.arange(0, 30, 0.02)
    throttle, zero = 0.5 + 0.4 * np.sign(np.sin(0.8 * time)), 0 * time
    position = np.empty_like(time)
    position[0] = throttle[0]
    for i in range(1, len(time)):
        position[i] = position[i - 1] + 0.02 * 2.0 * (throttle[i - 1] - position[i - 1])
    columns = {"t": time, "x": 5 * time, "y": zero, "yaw": zero, "throttle": throttle, "brake": zero, "steer": zero}
    table = np.column_stack([*columns.values(), 100 * position])
    np.savetxt(
        tmp_path / "drive.csv", table, delimiter=",", header=",".join((*columns, "flap")), comments="", fmt="%.9g"
    )
    arguments = ("--rig", tmp_path / "rig.toml", "--out", tmp_path / "d.zarr", "--split", "blocks:1,0,0")
    extracted = offpiste("extract", tmp_path / "drive.csv", *arguments, extension="throttle_lag")
    assert extracted.returncode == 0, extracted.stderr
    rolled = python("-c", ROLL_OUT, tmp_path / "d.zarr", extension="throttle_lag")
    assert rolled.returncode == 0, rolled.stderr
    assert int(rolled.stdout) > 10
