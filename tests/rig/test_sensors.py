"""Cameras and LiDARs of rigs, and errors in one line."""

import numpy as np
import pytest

from factories import RIG
from offpiste.core.errors import RigError
from offpiste.rig.rig import load_rig, parse_rig
from offpiste.rig.sensors import Mounting

CAMERA = '[cameras.front]\ntopic = "/front"\ninfo = "/front/info"\n'
LIDAR = '[lidars.top]\ntopic = "/points"\n'
INTRINSICS = "[cameras.front.intrinsics]\nwidth = 8\nheight = 6\nfocal_length = [5.0, 5.0]\ncentre = [3.5, 2.5]\n"

WRONG = {
    "unknown key": (CAMERA + "exposure = 1\n", r"cameras\.front: .*`exposure`"),
    "no topic": ("[lidars.top]\n", r"`topic`"),
    "no calibration": ('[cameras.front]\ntopic = "/front"\n', r"cameras\.front has no calibration"),
    "two calibrations": (CAMERA + INTRINSICS, r"cameras\.front has two calibrations"),
    "no focal length": (
        '[cameras.front]\ntopic = "f"\n' + INTRINSICS.replace("[5.0, 5.0]", "[0.0, 5.0]"),
        r"cameras\.front\.intrinsics",
    ),
    "unknown lens": ('[cameras.front]\ntopic = "f"\n' + INTRINSICS + 'model = "pinhole"\n', r"pinhole"),
    "bits": (CAMERA + "bits = 20\n", r"cameras\.front\.bits is 20; give 8 to 16"),
    "polygon of two": (CAMERA + "own_body = [[[0, 0], [1, 1]]]\n", r"less than three corners"),
    "no rotation": (
        LIDAR + "[lidars.top.body_from_lidar]\nposition = [0, 0, 1]\norientation = [0, 0, 0, 2]\n",
        r"body_from_lidar\.orientation is not a unit quaternion",
    ),
    "range backwards": (LIDAR + "min_range = 5.0\nmax_range = 2.0\n", r"min_range 5\.0 is not below max_range 2\.0"),
    "box inside out": (LIDAR + "own_body = [[1, 1, 1], [0, 0, 0]]\n", r"own_body is not a box"),
    "unit of time": (LIDAR + 'time_unit = "minutes"\n', r"minutes"),
    "delay is no number": (LIDAR + "delay = nan\n", r"lidars\.top\.delay is nan"),
    "one name for two": (CAMERA + LIDAR.replace("lidars.top", "lidars.front"), r"'front' is both a camera and a LiDAR"),
}


@pytest.mark.parametrize("case", WRONG)
def test_mistakes_are_named_in_one_line(case):
    text, message = WRONG[case]
    with pytest.raises(RigError, match=message) as error:
        parse_rig(RIG + text, where="mine.toml")
    assert "mine.toml" in str(error.value)
    assert "\n" not in str(error.value)


def test_times_since_1970_are_of_a_clock_that_arrivals_are_not_of():
    text = RIG + LIDAR + 'time_field = "t"\ntime_origin = "epoch"\n'
    assert parse_rig(text, where="mine.toml").lidars["top"].time_origin == "epoch"
    with pytest.raises(RigError, match=r'lidars\.top\.time_origin is "epoch" and clock\.stamps is "receive"'):
        parse_rig(text + '[clock]\nstamps = "receive"\n', where="mine.toml")


def test_a_mask_lies_beside_its_rig(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(RIG + CAMERA + 'mask = "front.png"\n')
    assert load_rig(path).cameras["front"].mask == str(tmp_path / "front.png")


def test_the_documented_orientation_looks_ahead():
    matrix = Mounting((1.0, 2.0, 3.0), (-0.5, 0.5, -0.5, 0.5)).matrix()
    ahead, right, down = matrix[:3, 2], matrix[:3, 0], matrix[:3, 1]
    np.testing.assert_allclose([ahead, right, down], [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=1e-12)
    np.testing.assert_allclose(matrix[:3, 3], [1, 2, 3])


def test_the_proving_grounds_rig_masks_what_its_cameras_see_of_the_vehicle():
    from offpiste.perception.camera import mask_from_polygons
    from offpiste.simulation.sensors.camera import Camera
    from offpiste.simulation.sensors.suite import full_suite

    rig = load_rig("proving_ground")
    for settings in full_suite().cameras[:2]:
        camera = Camera(settings)
        own = camera.in_rows(camera.own).distance.reshape(settings.model.height, settings.model.width)
        mask = mask_from_polygons(rig.cameras[settings.name].own_body, *settings.model.size)
        seen = np.isfinite(own) & (own < 100)
        assert (seen & ~mask).sum() < 0.02 * seen.sum()
        assert (mask & ~seen).mean() < 0.01


def test_a_rough_guess_looks_somewhere():
    left = Mounting(looks="left")
    np.testing.assert_allclose(left.matrix()[:3, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(left.matrix(optical=True)[:3, :3] @ [0, 0, 1], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(left.matrix(optical=True)[:3, :3] @ [0, 1, 0], [0, 0, -1], atol=1e-12)
    ahead = Mounting((0.0, 0.0, 0.0), (-0.5, 0.5, -0.5, 0.5)).matrix()
    np.testing.assert_allclose(Mounting(looks="forward").matrix(optical=True), ahead, atol=1e-12)
    assert left.is_rough
