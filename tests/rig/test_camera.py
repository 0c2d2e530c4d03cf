"""Projection and its inverse for all distortion models, and bad calibrations."""

import dataclasses

import numpy as np
import pytest

from camera_models import MODELS
from offpiste.core.errors import LogError, PerceptionError
from offpiste.logs.ros.writer import make
from offpiste.rig.camera import CameraModel, model_from_message
from sensor_bags import info


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> CameraModel:
    return MODELS[request.param]


def test_unprojecting_undoes_projecting(model: CameraModel):
    rays = np.random.default_rng(0).uniform(-0.7, 0.7, size=(200, 2))
    pixels = model.project(np.column_stack((rays, np.ones(200))))
    inside = ((pixels > 0) & (pixels < [639, 479])).all(axis=1)
    assert inside.sum() > 100
    assert np.allclose(model.unproject(pixels[inside]), rays[inside], atol=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"distortion_model": "double_sphere"}, r"^camera: unknown distortion model 'double_sphere'; known"),
        ({"distortion_model": ""}, "unknown distortion model ''"),
        ({"distortion": (0.1, 0.2)}, "2 distortion coefficients, plumb_bob has 0 or 4 or 5"),
        ({"matrix": np.zeros((3, 3))}, "uncalibrated: its focal length is 0"),
        ({"matrix": np.full((3, 3), np.nan)}, "calibration is not finite"),
        ({"width": 0}, "invalid image size 0x480 pixels"),
    ],
)
def test_bad_calibrations_are_named(change: dict, message: str):
    with pytest.raises(PerceptionError, match=message):
        dataclasses.replace(MODELS["plumb_bob"], **change).validate("camera")


def _region(binning: int = 0, **given: int) -> object:
    region = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0} | given
    roi = make("sensor_msgs/RegionOfInterest", do_rectify=False, **region)
    return info(binning_x=binning, binning_y=binning, roi=roi)


@pytest.mark.parametrize("given", [{}, {"width": 8, "height": 6}, {"binning": 1}])
def test_a_region_that_is_the_full_image_is_none(given: dict):
    model, _ = model_from_message(_region(**given), "/info", rectified=False)
    assert (model.width, model.height) == (8, 6)


@pytest.mark.parametrize("given", [{"width": 4, "height": 6}, {"width": 8}, {"y_offset": 1}, {"binning": 2}])
def test_part_of_an_image_is_refused(given: dict):
    with pytest.raises(LogError, match="binning or a region of interest"):
        model_from_message(_region(**given), "/info", rectified=False)


def test_many_points_are_projected_as_each_alone(model: CameraModel):
    points = np.random.default_rng(1).uniform((-2, -2, 1), (2, 2, 5), size=(5000, 3))
    some = np.arange(0, len(points), 97)
    assert np.array_equal(model.project(points)[some], np.concatenate([model.project(points[[n]]) for n in some]))
    assert model.project(points[:0]).shape == (0, 2)
