"""What processes hand on is what they were given, and holds no code."""

import numpy as np
import pytest
import torch

from live.made_up_robot import RIG, rig
from offpiste.live.packing import (
    cloud_from,
    course_from,
    image_from,
    layers_from,
    pack_course,
    pack_layers,
    pack_measured,
    pack_plan,
    pack_sensors,
    packed,
    plan_from,
    reading_from,
    sensors_from,
    unpacked,
)
from offpiste.logs.measurements import Camera, Cloud, Image, Lidar
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.planning.course import Course
from offpiste.rig.camera import CameraModel
from offpiste.rig.rig import parse_rig
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.follower import TimedPlan
from offpiste.runtime.prediction import Prediction


def same(a, b):
    for name in a.__dataclass_fields__:
        one, other = getattr(a, name), getattr(b, name)
        if isinstance(one, np.ndarray):
            assert one.dtype == other.dtype
            np.testing.assert_array_equal(one, other)
        else:
            assert one == other


def test_readings_images_and_scans():
    rng = np.random.default_rng(0)
    reading = VehicleReading(3.0, rng.normal(size=3), rng.normal(size=4), rng.normal(size=3), 0.1, np.full(4, np.nan))
    values = unpacked(pack_measured(reading, control=None))
    same(reading, reading_from(values))
    assert values["control"] is None
    image = Image(1.0, "eye", rng.integers(0, 255, (4, 6, 3)).astype(np.uint8))
    same(image, image_from(unpacked(pack_measured(image))))
    scan = Cloud(1.0, "lidar", rng.normal(size=(5, 3)), None, np.full(5, np.nan))
    same(scan, cloud_from(unpacked(pack_measured(scan))))


def test_courses_plans_and_layers():
    course = Course(np.array([[0.0, 0.0], [5.0, 1.0]]), np.array([2.0, 3.0]))
    same(course, course_from(unpacked(pack_course(course))))
    plan = TimedPlan(1.0, 0.9, torch.rand(5, 3))
    prediction = Prediction(1.0, np.random.default_rng(0).normal(size=(5, 6)))
    timed, predicted = plan_from(unpacked(pack_plan(plan, prediction, empty=False, stuck=False)))
    assert torch.equal(timed.controls, plan.controls)
    assert (timed.start, timed.made) == (1.0, 0.9)
    same(prediction, predicted)
    grid = np.zeros((3, 4))
    layers = TerrainLayers(
        np.zeros(2), 0.5, grid, np.zeros((3, 4, 3)), grid, grid, grid, np.zeros((3, 4, 2)), grid,
        grid == 0, grid == 0, grid != 0,
    )  # fmt: skip
    same(layers, layers_from(unpacked(pack_layers(layers, scan_time=-np.inf))))
    assert layers_from(unpacked(pack_layers(None))) is None


def test_sensors_have_what_the_rig_says_of_them():
    vehicle, mounting = rig(), np.eye(4)
    mounting[2, 3] = 2.0
    lidars = {"lidar": Lidar("lidar", mounting, vehicle.lidars["lidar"])}
    cameras, known = sensors_from(unpacked(pack_sensors(({}, lidars))), vehicle)
    assert cameras == {}
    same(known["lidar"], lidars["lidar"])
    camera = parse_rig(RIG + '[cameras.eye]\ntopic = "/eye"\ninfo = "/info"\n', where="test")
    model = CameraModel(8, 6, np.eye(3), (0.1, 0.0, 0.0, 0.0))
    eye = Camera("eye", model, mounting, camera.cameras["eye"])
    found = sensors_from(unpacked(pack_sensors(({"eye": eye}, {}))), camera)[0]["eye"]
    same(model, found.model)
    np.testing.assert_array_equal(found.body_from_camera, mounting)


def test_other_things_are_not_packed():
    with pytest.raises(NotImplementedError):
        packed({"model": torch.zeros(1)})
