"""An actuator from outside the package: from a log's channel through a model's lag to its prediction."""

import numpy as np

from extending.outside import extracted_car, python
from offpiste.conventions import DT

CHANNEL = 'throttle_position = { fields = ["flap"], unit = "percent" }'

ROLL_OUT = """
import sys
from dataclasses import replace
import torch
from offpiste.dataset.store import open_dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import MODELS
from offpiste.dynamics.inputs import drive_train
from offpiste.training.build import vehicle_of
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
    model = MODELS[name](vehicle, seed=0)
    rate = model.actuators.constant_names.index(("throttle", "rate"))
    model.actuators.raw.data[rate] = torch.logit(torch.tensor(1.9 / 39.9))  # 2 / s
    predicted = predict(model, batch).actuators[..., 4]
    torch.testing.assert_close(predicted, batch.target_actuators[..., 4], atol=0.02, rtol=0)
print(len(batch.state))
"""


def test_an_added_actuator_lags_behind_its_command(tmp_path):
    time = np.arange(0, 30, DT)
    throttle = 0.5 + 0.4 * np.sign(np.sin(0.8 * time))
    position = np.empty_like(time)
    position[0] = throttle[0]
    for i in range(1, len(time)):
        position[i] = position[i - 1] + DT * 2.0 * (throttle[i - 1] - position[i - 1])
    dataset = extracted_car(tmp_path, CHANNEL, extension="throttle_lag", throttle=throttle, flap=100 * position)
    rolled = python("-c", ROLL_OUT, dataset, extension="throttle_lag")
    assert rolled.returncode == 0, rolled.stderr
    assert int(rolled.stdout) > 10
