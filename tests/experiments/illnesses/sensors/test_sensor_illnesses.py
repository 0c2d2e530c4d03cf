"""Every illness of a sensor changes what is read, as much as its strength says, and the same seed gives the same."""

import numpy as np
import pytest

from experiments.illnesses.sensors.case import sensor_errors
from experiments.illnesses.sensors.declarations import SENSOR_ILLNESSES
from experiments.illnesses.sensors.drives import CAMERA, LIDAR
from made_up_sensors import GROUND, TIMES, body_points, sensor_case

IMAGES = "/camera_front/image/compressed"
CASE = sensor_case()


def given(name, strength, seed=1, case=CASE):
    return SENSOR_ILLNESSES[name].change(case, strength, np.random.default_rng(seed))


def shown(case):
    """Numbers of the images, in the order of time."""
    return [int(image.pixels[0, 0, 0]) for image in case.log.images_at(IMAGES, TIMES)]


def read(case):
    """All that an illness may change."""
    height = case.log.read("/odometry", ["pose.pose.position.z"]).values
    return case.rig, body_points(case).round(4).tolist(), shown(case), height.tolist()


@pytest.mark.parametrize("name", [name for name, _ in SENSOR_ILLNESSES.items()])
def test_each_changes_something_and_the_same_seed_gives_the_same(name):
    for strength in SENSOR_ILLNESSES[name].strengths:
        sick = read(given(name, strength))
        assert sick != read(CASE)
        assert sick == read(given(name, strength))


@pytest.mark.parametrize(("kind", "name"), [("camera", CAMERA), ("LiDAR", LIDAR)])
def test_turns_and_delays_are_as_large_as_they_say(kind, name):
    other = LIDAR if name == CAMERA else CAMERA
    assert sensor_errors(CASE.rig, CASE.layout, name) == (0, 0)
    for degrees in (0.5, 5.0):
        sick = given(f"{kind} turned", degrees)
        assert sensor_errors(sick.rig, CASE.layout, name) == pytest.approx((degrees, 0), abs=1e-6)
        assert sensor_errors(sick.rig, CASE.layout, other) == (0, 0)
    assert sensor_errors(given(f"{kind} late", 50.0).rig, CASE.layout, name) == pytest.approx((0, 0.05))


def test_a_post_stands_outside_the_box_of_the_own_body():
    sick = given("post in view", 0.15)
    clouds = [body_points(sick, time) for time in TIMES[:3]]
    for points in clouds:
        post = points[:, 2] > GROUND + 0.2
        assert post.sum() > 20
        assert np.linalg.norm(points[post, :2] - sick.part[:2], axis=1).max() < 0.15
    cured = SENSOR_ILLNESSES["post in view"].cured
    assert cured is not None
    assert not cured(sick, sick.rig)
    assert cured(sick, sick.with_rig((f"lidars.{LIDAR}.own_body", [[-3, -3, -1], [3, 3, 4]])).rig)
