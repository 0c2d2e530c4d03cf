"""What physics and networks read from a model state, and the reduced forms for channels that a log lacks."""

import math
from dataclasses import replace

import pytest
import torch

from factories import COMMANDED, VEHICLE, ground
from offpiste.core.errors import DatasetError
from offpiste.core.state import Terrain
from offpiste.dynamics.inputs import body_normal, drive_train, rotate_by_minus_yaw, select_present, unknown_normals

STATE = torch.tensor([[1.0, 2.0, 0.3, -5.0, 0.1, 0.2]])
ACTUATORS = torch.tensor([[0.6, 0.2, 0.0, 3.0]])
CONTROL = torch.tensor([[0.7, 0.5, -0.5]])
NOTHING = torch.full((1, 4), torch.nan)


def test_recorded_actuators_are_read():
    train = drive_train(VEHICLE, STATE, ACTUATORS, CONTROL)
    assert [x.item() for x in train] == pytest.approx([0.7, 0.6, 0.2, 3.0, 1.0])


def test_commands_stand_in_for_absent_actuators():
    train = drive_train(COMMANDED, STATE, NOTHING, CONTROL)
    # Engine: |vx| / 10 m/s, also in reverse.
    assert [x.item() for x in train] == pytest.approx([0.7, 0.5, 0.4 * -0.5, 0.5, 1.0])


def test_absent_pedals_count_as_released():
    vehicle = replace(COMMANDED, control=("steer",))
    train = drive_train(vehicle, STATE, NOTHING, torch.tensor([[math.nan, math.nan, 1.0]]))
    assert [x.item() for x in train] == pytest.approx([0.0, 0.0, 0.4, 0.5, 1.0])


def test_a_gear_is_read_where_the_log_has_one():
    geared = replace(VEHICLE, control=(*VEHICLE.control, "gear"))
    control = torch.cat((CONTROL, torch.tensor([[-1.0]])), dim=-1)
    assert drive_train(geared, STATE, ACTUATORS, control).gear.item() == -1
    assert select_present(geared, ACTUATORS, control)[0, -1].item() == -1


def test_no_steering_at_all_is_an_error():
    with pytest.raises(DatasetError, match="neither a steering angle nor a steering command"):
        drive_train(replace(COMMANDED, control=("throttle",)), STATE, NOTHING, CONTROL)


def test_a_steering_angle_needs_its_rate():
    with pytest.raises(ValueError, match="rate"):
        replace(VEHICLE, actuators=("steer",))


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5, math.pi])
def test_nose_up_tilts_the_body_normal_back(yaw):
    slope = 0.3
    up = ground(*(torch.full((1, 4), slope * turn, dtype=torch.float64) for turn in (math.cos(yaw), math.sin(yaw))))
    normal = body_normal(up, torch.tensor([yaw], dtype=torch.float64))
    angle = math.atan(slope)
    torch.testing.assert_close(normal, torch.tensor([[-math.sin(angle), 0.0, math.cos(angle)]]).double())


def test_a_bank_that_falls_to_the_right_tilts_the_normal_right():
    yaw = math.pi / 2  # facing +y; the right is +x
    falls = ground(torch.full((1, 4), -0.2), torch.zeros(1, 4))
    normal = body_normal(falls, torch.tensor([yaw]))
    assert normal[0, 1] < -0.19
    assert abs(normal[0, 0]) < 1e-6


def test_wheels_count_alike():
    normal = torch.eye(3).repeat(2, 1)[:4].expand(1, 4, 3)
    mean = body_normal(Terrain.of(normal), torch.zeros(1))
    torch.testing.assert_close(mean, torch.tensor([[0.5, 0.25, 0.25]]))


@pytest.mark.parametrize("unknown", range(5))
def test_unknown_normals_are_counted_and_straight_up_stands_for_them(unknown):
    normal = torch.tensor([0.6, 0.0, 0.8]).repeat(3, 4, 1)
    normal[1, :unknown] = torch.nan
    terrain = Terrain.of(normal)
    assert unknown_normals(terrain).tolist() == [[0.0], [unknown / 4], [0.0]]
    mean = body_normal(terrain, torch.zeros(3))[1]
    torch.testing.assert_close(mean, torch.tensor([0.6 * (4 - unknown) / 4, 0.0, (0.8 * (4 - unknown) + unknown) / 4]))


def test_networks_see_present_columns_in_order():
    vehicle = replace(VEHICLE, actuators=("brake", "engine_rpm"), control=("throttle", "steer"))
    assert select_present(vehicle, ACTUATORS, CONTROL)[0].tolist() == pytest.approx([0.6, 3.0, 0.7, -0.5])
    assert select_present(replace(vehicle, actuators=(), control=()), ACTUATORS, CONTROL).shape == (1, 0)


def test_a_vector_to_the_left_of_the_heading_is_left_in_the_body():
    yaw = torch.tensor([0.3, -2.0])
    left = torch.stack((-yaw.sin(), yaw.cos(), torch.full_like(yaw, 0.5)), dim=-1)
    torch.testing.assert_close(rotate_by_minus_yaw(left, yaw), torch.tensor([[0.0, 1.0, 0.5], [0.0, 1.0, 0.5]]))
