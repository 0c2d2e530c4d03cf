"""Inputs of physics and networks from a model state, with reduced forms for channels that a log lacks."""

import math
from dataclasses import replace

import pytest
import torch

from factories import COMMANDED, VEHICLE, ground
from offpiste.core.errors import DatasetError
from offpiste.core.state import Terrain
from offpiste.dynamics.torch_physics import drive_train, mean_normal, select_present, unknown_normals

STATE = torch.tensor([[1.0, 2.0, 0.3, -5.0, 0.1, 0.2]])
ACTUATORS = torch.tensor([[0.6, 0.2, 0.0, 3.0]])
CONTROL = torch.tensor([[0.7, 0.5, -0.5]])
GEARED = replace(VEHICLE, control=(*VEHICLE.control, "gear"))


@pytest.mark.parametrize(
    ("vehicle", "actuators", "control", "wanted"),
    [
        (VEHICLE, ACTUATORS, CONTROL, [0.7, 0.6, 0.2, 3.0, 1.0]),
        (GEARED, ACTUATORS, torch.tensor([[0.7, 0.5, -0.5, -1.0]]), [0.7, 0.6, 0.2, 3.0, -1.0]),
        # Engine: |vx| / 10 m/s, also in reverse.
        (COMMANDED, ACTUATORS * torch.nan, CONTROL, [0.7, 0.5, 0.4 * -0.5, 0.5, 1.0]),
        (
            replace(COMMANDED, control=("steer",)), ACTUATORS * torch.nan,
            torch.tensor([[math.nan, math.nan, 1.0]]), [0.0, 0.0, 0.4, 0.5, 1.0],
        ),
    ],
    ids=["measured", "gear", "commands", "absent pedals"],
)  # fmt: skip
def test_inputs_are_measured_or_reduced(vehicle, actuators, control, wanted):
    assert [x.item() for x in drive_train(vehicle, STATE, actuators, control)] == pytest.approx(wanted)


def test_a_vehicle_without_steering_or_steering_rate_is_refused():
    with pytest.raises(DatasetError, match="neither a steering angle nor a steering command"):
        drive_train(replace(COMMANDED, control=("throttle",)), STATE, ACTUATORS, CONTROL)
    with pytest.raises(ValueError, match="rate"):
        replace(VEHICLE, actuators=("steer",))


@pytest.mark.parametrize("yaw", [0.0, -2.5])
def test_nose_up_tilts_the_normal_back_and_a_bank_falling_right_tilts_it_right(yaw):
    slope = 0.3
    along = [torch.full((1, 4), slope * turn, dtype=torch.float64) for turn in (math.cos(yaw), math.sin(yaw))]
    normal = mean_normal(ground(*along), torch.tensor([yaw], dtype=torch.float64))
    angle = math.atan(slope)
    torch.testing.assert_close(normal, torch.tensor([[-math.sin(angle), 0.0, math.cos(angle)]]).double())
    falls = mean_normal(ground(-along[1], along[0]), torch.tensor([yaw], dtype=torch.float64))
    torch.testing.assert_close(falls, torch.tensor([[0.0, -math.sin(angle), math.cos(angle)]]).double())


@pytest.mark.parametrize("unknown", [0, 1, 4])
def test_wheels_count_equally_and_unknown_normals_as_vertical(unknown):
    normal = torch.tensor([0.6, 0.0, 0.8]).repeat(3, 4, 1)
    normal[1, :unknown] = torch.nan
    terrain = Terrain.of(normal)
    assert unknown_normals(terrain).tolist() == [[0.0], [unknown / 4], [0.0]]
    mean = mean_normal(terrain, torch.zeros(3))[1]
    torch.testing.assert_close(mean, torch.tensor([0.6 * (4 - unknown) / 4, 0.0, (0.8 * (4 - unknown) + unknown) / 4]))


def test_networks_read_present_columns_in_order():
    vehicle = replace(VEHICLE, actuators=("brake", "engine_rpm"), control=("throttle", "steer"))
    assert select_present(vehicle, ACTUATORS, CONTROL)[0].tolist() == pytest.approx([0.6, 3.0, 0.7, -0.5])
    assert select_present(replace(vehicle, actuators=(), control=()), ACTUATORS, CONTROL).shape == (1, 0)
