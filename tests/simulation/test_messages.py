import cv2
import numpy as np

from offpiste.logs.ros.sensor_messages import points_from_message
from offpiste.logs.ros.writer import message_types
from offpiste.rig.camera import CameraModel
from offpiste.simulation.messages import camera_info_message, image_message, points_message

STAMP = 1_700_000_000_250_000_000


def through_bytes(message: object) -> object:
    store = message_types()
    return store.deserialize_cdr(bytes(store.serialize_cdr(message, message.__msgtype__)), message.__msgtype__)


def test_an_image_keeps_its_colours() -> None:
    image = np.zeros((40, 60, 3), np.uint8)
    image[:, :20], image[:, 20:40], image[20:, 40:] = (220, 30, 30), (30, 200, 30), (20, 40, 230)
    message = through_bytes(image_message(image, STAMP, "camera_front"))
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_700_000_000, 250_000_000)
    assert (message.header.frame_id, message.format) == ("camera_front", "jpeg")
    decoded = cv2.imdecode(message.data, cv2.IMREAD_COLOR)[:, :, ::-1].astype(int)
    for row, column in ((5, 10), (5, 30), (35, 50)):
        assert np.abs(decoded[row, column] - image[row, column]).max() < 12


def test_a_calibration_projects_as_its_camera_does() -> None:
    matrix = np.array([[500.0, 0.0, 320.5], [0.0, 510.0, 240.25], [0.0, 0.0, 1.0]])
    distortion = np.array([-0.2, 0.05, 0.001, -0.002, 0.01])
    model = CameraModel(640, 480, matrix, tuple(distortion))
    message = through_bytes(camera_info_message(model, STAMP, "camera_front"))
    assert (message.width, message.height, message.distortion_model) == (640, 480, "plumb_bob")
    np.testing.assert_array_equal(message.d, distortion)
    np.testing.assert_array_equal(message.r, np.eye(3).reshape(-1))
    point = np.array([0.4, -0.2, 2.0])
    seen, _ = cv2.projectPoints(point[None], np.zeros(3), np.zeros(3), message.k.reshape(3, 3), np.zeros(5))
    projected = message.p.reshape(3, 4) @ np.append(point, 1)
    np.testing.assert_allclose(projected[:2] / projected[2], seen.reshape(2))


def test_a_scan_comes_back() -> None:
    random = np.random.default_rng(0)
    xyz, intensity = random.normal(size=(50, 3)), random.random(50)
    ring, time = np.arange(50) % 7, np.linspace(0, 0.1, 50)
    message = through_bytes(points_message(xyz, intensity, ring, time, STAMP, "lidar_top"))
    assert [field.name for field in message.fields] == ["x", "y", "z", "intensity", "ring", "t"]
    points = points_from_message(message)
    np.testing.assert_allclose(np.stack([points[c] for c in "xyz"], axis=1), xyz, rtol=1e-6)
    np.testing.assert_allclose(points["intensity"], intensity, rtol=1e-6)
    np.testing.assert_array_equal(points["ring"], ring)
    np.testing.assert_allclose(points["t"] / 1e9, time, atol=1e-9)
    assert (
        len(points_from_message(through_bytes(points_message(xyz[:0], intensity[:0], ring[:0], time[:0], 0, "")))) == 0
    )
