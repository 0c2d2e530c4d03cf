"""Rectification against OpenCV's own projection, for all distortion models; identity."""

import dataclasses

import cv2
import numpy as np
import pytest

from camera_models import MATRIX, MODELS
from offpiste.core.errors import PerceptionError
from offpiste.perception.camera import make_rectifier, pinhole_matrix
from offpiste.rig.camera import CameraModel


def opencv_pixels(model: CameraModel, points: np.ndarray) -> np.ndarray:
    nothing, coefficients = np.zeros(3), np.array(model.distortion)
    if model.distortion_model == "equidistant":
        pixels, _ = cv2.fisheye.projectPoints(points[:, None], nothing, nothing, model.matrix, coefficients)
        return pixels.reshape(-1, 2)
    return cv2.projectPoints(points, nothing, nothing, model.matrix, coefficients)[0].reshape(-1, 2)


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> CameraModel:
    return MODELS[request.param]


def test_a_spot_appears_where_the_pinhole_sees_it(model: CameraModel):
    """Points in space, drawn into the distorted image by OpenCV, lie in the rectified one where its K says."""
    rectifier = make_rectifier(model)
    pixels = np.array([[x, y] for x in (40.0, 200.0, 320.0, 470.0, 600.0) for y in (40.0, 230.0, 440.0)])
    points = 7.0 * np.column_stack((pixels, np.ones(len(pixels)))) @ np.linalg.inv(rectifier.pinhole.matrix).T
    y, x = np.mgrid[: model.height, : model.width]
    for point, wanted in zip(points, pixels, strict=True):
        spot = opencv_pixels(model, point[None])[0]
        image = 255 * np.exp(-((x - spot[0]) ** 2 + (y - spot[1]) ** 2) / (2 * 3.0**2))
        rectified = rectifier(image.astype(np.float32)[..., None].repeat(3, axis=2))[..., 0].astype(float)
        found = np.array([(rectified * x).sum(), (rectified * y).sum()]) / rectified.sum()
        assert np.abs(found - wanted).max() < 0.3  # the spot is not round any more, so its middle shifts a little


def test_the_default_view_has_no_gap_and_is_the_widest(model: CameraModel):
    rectifier = make_rectifier(model)
    assert rectifier.valid.all()
    wider = rectifier.pinhole.matrix.copy()
    wider[[0, 1], [0, 1]] *= 0.97
    assert not make_rectifier(model, matrix=wider).valid.all()
    assert wider[0, 0] / wider[1, 1] == pytest.approx(310 / 312)


@pytest.mark.parametrize(
    ("kind", "count"), [("plumb_bob", 0), ("plumb_bob", 4), ("plumb_bob", 5), ("rational_polynomial", 8)]
)
def test_no_distortion_is_the_identity(kind: str, count: int):
    model = CameraModel(640, 480, MATRIX, (0.0,) * count, kind)
    rectifier = make_rectifier(model)
    image = np.random.default_rng(0).integers(0, 256, size=(480, 640, 3), dtype=np.uint8)
    assert np.allclose(rectifier.pinhole.matrix, MATRIX)
    assert np.array_equal(rectifier(image), image)
    assert rectifier.valid.all()


def test_another_size_keeps_the_view():
    model = MODELS["plumb_bob"]
    full, half = make_rectifier(model), make_rectifier(model, size=(320, 240))
    image = np.zeros((480, 640, 3), dtype=np.uint8)
    image[100:140, 300:360] = 255
    shrunk = cv2.resize(full(image), (320, 240), interpolation=cv2.INTER_AREA)
    assert np.abs(half(image).astype(int) - shrunk).mean() < 0.1
    corner = np.array([-0.5, -0.5, 1.0])  # the outermost corner of the image is the same ray
    assert np.allclose(np.linalg.solve(half.pinhole.matrix, corner), np.linalg.solve(full.pinhole.matrix, corner))


def test_a_fisheye_that_sees_behind_itself_gives_a_pinhole_that_does_not():
    matrix = np.array([[170.0, 0.0, 319.5], [0.0, 170.0, 239.5], [0.0, 0.0, 1.0]])
    rectifier = make_rectifier(CameraModel(640, 480, matrix, (0.0, 0.0, 0.0, 0.0), "equidistant"))
    assert rectifier.valid.all()
    half_view = np.degrees(np.arctan(320 / rectifier.pinhole.matrix[0, 0]))
    assert 55 < half_view <= 65.1


def test_no_ghosts_where_the_polynomial_folds_back():
    """Far outside the camera's view, k1 < 0 projects back into the image; those pixels must be black."""
    model = MODELS["plumb_bob"]
    wide = np.array([[60.0, 0.0, 320.0], [0.0, 60.0, 240.0], [0.0, 0.0, 1.0]])
    rectifier = make_rectifier(dataclasses.replace(model, distortion=(-0.227, 0.0, 0.0, 0.0, 0.0)), matrix=wide)
    image = np.full((480, 640, 3), 200, dtype=np.uint8)
    rectified = rectifier(image)
    assert (rectified[0] == 0).all()
    assert not rectifier.valid[0].any()
    assert rectifier.valid[240, 320]
    assert (rectified[rectifier.valid] > 90).all()


def test_masks_stay_masks():
    rectifier = make_rectifier(MODELS["plumb_bob"])
    mask = np.zeros((480, 640), dtype=bool)
    mask[400:] = True
    rectified = rectifier.mask(mask)
    assert rectified.dtype == bool
    assert rectified[479].all()
    assert not rectified[:300].any()


def test_a_bad_calibration_is_refused():
    with pytest.raises(PerceptionError, match=r"^left: calibration is not finite"):
        make_rectifier(dataclasses.replace(MODELS["plumb_bob"], matrix=np.full((3, 3), np.nan)), name="left")


def test_an_image_of_another_size_is_refused():
    with pytest.raises(PerceptionError, match=r"^camera: an image of 320x240, calibrated for 640x480; give"):
        make_rectifier(MODELS["plumb_bob"])(np.zeros((240, 320, 3), dtype=np.uint8))


def test_a_distortion_that_folds_the_image_over_is_named():
    with pytest.raises(PerceptionError, match="folds the image over; check the order and sign"):
        pinhole_matrix(CameraModel(640, 480, MATRIX, (-0.9, 0.0, 0.0, 0.0), "plumb_bob"))
