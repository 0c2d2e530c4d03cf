"""Rectification against OpenCV's projection for all distortion models, and masks of the vehicle's body."""

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

from camera_models import MATRIX, MODELS
from offpiste.core.errors import PerceptionError
from offpiste.logs.measurements import Camera
from offpiste.perception.camera import make_pinhole_camera, make_rectifier, mask_from_polygons, own_body
from offpiste.rig.camera import CameraModel
from offpiste.rig.sensors import CameraSource


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
    y, x = np.mgrid[: model.height, : model.width]
    rays = np.stack((x, y, np.ones_like(x)), axis=-1).reshape(-1, 3) @ np.linalg.inv(wider).T
    places = model.project(rays)
    assert ((places < -0.5) | (places > np.array(model.size) - 0.5)).any()
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


def test_a_fisheye_that_sees_behind_itself_gives_a_pinhole_that_does_not():
    matrix = np.array([[170.0, 0.0, 319.5], [0.0, 170.0, 239.5], [0.0, 0.0, 1.0]])
    rectifier = make_rectifier(CameraModel(640, 480, matrix, (0.0, 0.0, 0.0, 0.0), "equidistant"))
    assert rectifier.valid.all()
    half_view = np.degrees(np.arctan(320 / rectifier.pinhole.matrix[0, 0]))
    assert 55 < half_view <= 65.1


def test_a_calibration_that_does_not_fit_is_refused():
    model = MODELS["plumb_bob"]
    with pytest.raises(PerceptionError, match=r"^left: calibration is not finite"):
        make_rectifier(dataclasses.replace(model, matrix=np.full((3, 3), np.nan)), name="left")
    with pytest.raises(PerceptionError, match=r"^camera: images are 320x240 pixels, the calibration 640x480; give"):
        make_rectifier(model)(np.zeros((240, 320, 3), dtype=np.uint8))
    with pytest.raises(PerceptionError, match="folds the image over; check the order and sign"):
        make_rectifier(CameraModel(640, 480, MATRIX, (-0.9, 0.0, 0.0, 0.0), "plumb_bob"))


def camera(mask: str = "", own: tuple = (), size: tuple[int, int] = (30, 20)) -> Camera:
    model = CameraModel(*size, np.array([[20.0, 0.0, 14.5], [0.0, 20.0, 9.5], [0.0, 0.0, 1.0]]))
    return Camera("front", model, np.eye(4), CameraSource(topic="front", mask=mask, own_body=own))


def test_a_painted_mask_and_polygons_add_up(tmp_path: Path):
    painted = np.zeros((20, 30, 3), dtype=np.uint8)
    painted[15:, 5:25, 0] = 200
    cv2.imwrite(str(tmp_path / "bonnet.png"), painted)
    corner = ((0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (0.0, 3.0))
    mask = own_body(camera(str(tmp_path / "bonnet.png"), (corner,)))
    assert mask.sum() == 5 * 20 + 4 * 4
    assert mask[15, 5]
    assert mask[3, 3]
    with pytest.raises(PerceptionError, match=r"bonnet.png: the mask has 30x20 pixels, but the camera has 20x30"):
        own_body(camera(str(tmp_path / "bonnet.png"), size=(20, 30)))
    for content in (None, b"", b"text"):
        if content is not None:
            (tmp_path / "x.png").write_bytes(content)
        with pytest.raises(PerceptionError, match=r"x.png: cannot be read as a picture; give a PNG"):
            own_body(camera(str(tmp_path / "x.png")))


def test_polygons_overlap_without_cancelling_and_may_leave_the_image():
    square = [(2.0, 2.0), (9.0, 2.0), (9.0, 9.0), (2.0, 9.0)]
    mask = mask_from_polygons([square, [(x + 4, y) for x, y in square]], 20, 12)
    assert mask.sum() == 8 * 12
    assert mask[2:10, 2:14].all()
    below = mask_from_polygons([[(-50.0, 8.0), (70.0, 8.0), (70.0, 99.0), (-50.0, 99.0)]], 20, 12)
    assert below[8:].all()
    assert not below[:8].any()
    with pytest.raises(PerceptionError, match="polygon has 2 corners"):
        mask_from_polygons([[(0.0, 0.0), (1.0, 1.0)]], 20, 12)


def test_patches_with_a_little_of_the_body_are_usable():
    tenth = ((10.0, 9.0), (19.0, 9.0), (19.0, 9.0))
    fifth = ((20.0, 8.0), (29.0, 8.0), (29.0, 9.0), (20.0, 9.0))
    free = make_pinhole_camera(camera(own=(tenth, fifth), size=(30, 10)), 10).free
    assert free.tolist() == [[True, True, False]]
