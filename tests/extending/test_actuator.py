"""An actuator of an extension: its channel, its lag in a model, and its prediction."""

import numpy as np

from extending.outside import extracted_car, succeeded
from offpiste.core.conventions import DT
from synthetic_drive import lagged

CHANNEL = 'throttle_position = { fields = ["flap"], unit = "percent" }'

ROLL_OUT = """
import sys
from dataclasses import replace
import torch
from offpiste.dataset.store import open_dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import MODELS
from offpiste.dynamics.torch_physics import drive_train
from offpiste.training.run import vehicle_of
from offpiste.training.prediction import predict_batch

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
    predicted = predict_batch(model, batch).actuators[..., 4]
    torch.testing.assert_close(predicted, batch.target_actuators[..., 4], atol=0.02, rtol=0)
print(len(batch.state))
"""


DRIVE = """
from pathlib import Path
import numpy as np
from live.synthetic_robot import RIG, START, odometry
from offpiste.runtime.planner import Planner, warm_up
from offpiste.core.conventions import CONTROL
from offpiste.dynamics import Parametric, Vehicle
from offpiste.live.ring import from_fields, pack_fields, unpacked
from offpiste.live.robot_messages import VehicleMessages
from offpiste.live.session import refuse_unmeasured
from offpiste.runtime.estimator import VehicleReading
from offpiste.logs.ros.writer import make
from offpiste.rig.outputs import Timeouts
from offpiste.rig.rig import parse_rig
from offpiste.runtime.estimator import VehicleTrack
from offpiste.runtime.estimator import Intake
from offpiste.runtime.runtime import Runtime
from offpiste.transport.received import Tally
from runtime.stream import WHEELS, sensor_setup, settings

channel = '[channels.throttle_position]\\ntopic = "/flap"\\nfields = ["data"]\\n[lidars'
rig, now = parse_rig(RIG.replace("[lidars", channel), where="test"), START / 1e9
model = Parametric(Vehicle(1150.0, 2.06, 0.5, CONTROL, rig.present_actuators))
refuse_unmeasured(Planner("parametric", Path("run"), model), rig)
messages, track = VehicleMessages(rig), VehicleTrack(actuators=model.vehicle.actuators)
intake = Intake(track, model.vehicle.actuators, Timeouts(), Tally())
assert intake.vehicle(messages.take("/odom", odometry(0.0), now)) == "dropped"
assert dict(intake.dropped) == {"readings of the vehicle without throttle_position, which the model reads": 1}
messages.take("/flap", make("std_msgs/Float64", data=0.3), now + 0.02)
reading = messages.take("/odom", odometry(0.02), now + 0.02)
assert intake.vehicle(from_fields(VehicleReading, unpacked(pack_fields(reading)))) == "taken"
assert track.rows(now + 0.02).actuators[-1].tolist()[4:] == [0.3]
made, plan = [], Runtime._plan
Runtime._plan = lambda runtime, *given: made.append(runtime) or plan(runtime, *given)
warm_up(model, sensor_setup(), WHEELS, settings())
assert made[-1].predictions and not made[-1].failures, made[-1].failures
print("driven")
"""


def test_the_run_time_reads_an_added_actuator_and_plans_with_it():
    assert succeeded("-c", DRIVE, extension="throttle_lag").endswith("driven\n")


def test_an_added_actuator_lags_behind_its_command(tmp_path):
    time = np.arange(0, 30, DT)
    throttle = 0.5 + 0.4 * np.sign(np.sin(0.8 * time))
    flap = 100 * lagged(throttle, 0.5)
    dataset = extracted_car(tmp_path, CHANNEL, extension="throttle_lag", throttle=throttle, flap=flap)
    assert int(succeeded("-c", ROLL_OUT, dataset, extension="throttle_lag")) > 10
