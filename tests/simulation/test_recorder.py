"""Recording and reading back of drives, and inspection of clean and faulty ones."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from offpiste.core.conventions import GRAVITY
from offpiste.inspection.inspect import inspect_log
from offpiste.logs import Drive, open_log, read_drive
from offpiste.logs.formats.bag import BagLog
from offpiste.logs.ground_truth import GROUND_PROPERTIES, WHEEL, WHEELS_TOPIC, read_truth_map
from offpiste.logs.ros.sensor_messages import points_from_message
from offpiste.logs.ros.writer import McapWriter, message_types
from offpiste.rig.camera import CameraModel
from offpiste.rig.rig import load_rig
from offpiste.simulation.messages import START_NS, camera_info_message, image_message, points_message
from offpiste.simulation.recorder import Drift, Imperfections, Recorder
from offpiste.simulation.sample import Pose, VehicleSample
from offpiste.simulation.vehicle.parameters import load_vehicle
from synthetic_drive import samples, simulated, small_world

RIG = load_rig("proving_ground")
RADIUS = load_vehicle().rolling_radius
MOUNTING = Pose(np.array((1.0, 0.0, 1.2)), np.array((-0.5, 0.5, -0.5, 0.5)))


def record(path: Path, driven: tuple[VehicleSample, ...] = samples(), **flaws: float) -> Path:
    with McapWriter(path) as writer:
        recorder = Recorder(writer, RADIUS, np.random.default_rng(0), Imperfections(**flaws))
        recorder.start(small_world(), {"camera_front": MOUNTING})
        for sample in driven:
            recorder.vehicle(sample)
        stamp = recorder.sensor_stamp_ns(0.25)
        recorder.sensor("/camera/image/compressed", image_message(np.zeros((4, 6, 3), np.uint8), stamp, "camera_front"))
    return path


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recorded") / "drive.mcap")


@pytest.fixture(scope="module")
def drive(clean: Path) -> Drive:
    return read_drive(clean, RIG)


def true(attribute: str) -> np.ndarray:
    return np.array([getattr(sample, attribute) for sample in samples()])


@pytest.mark.parametrize(
    ("channel", "expected", "sigma"),
    [
        ("position", true("position"), 0.005),
        ("throttle", true("command")[:, :1], 0),
        ("brake", true("command")[:, 1:2], 0),
        ("steer", true("command")[:, 2:], 0),
        ("steer_angle", true("steer_angle")[:, None], np.radians(0.1)),
        ("steer_rate", true("steer_rate")[:, None], np.radians(0.5)),
        ("engine_rpm", true("engine_speed")[:, None] / 1000, 0.01),
        ("wheel_speed", true("wheel_speed"), 0.02),
        ("angular_velocity", true("angular_velocity"), 0.005),
    ],
)
def test_channels_have_the_written_values_and_stamps(
    drive: Drive, channel: str, expected: np.ndarray, sigma: float
) -> None:
    np.testing.assert_allclose(drive.channels[channel].time - START_NS / 1e9, true("time"), atol=5e-7)
    error = drive.channels[channel].values - expected
    if sigma == 0:
        np.testing.assert_allclose(error, 0, atol=1e-7)  # float32
    else:
        np.testing.assert_allclose(error.std(axis=0), sigma, rtol=0.1)
        np.testing.assert_allclose(error.mean(axis=0), 0, atol=0.1 * sigma)


def test_imu_measures_gravity_and_lateral_acceleration(clean: Path) -> None:
    force = BagLog(clean).read("/imu", [f"linear_acceleration.{axis}" for axis in "xyz"]).values
    still = np.linalg.norm(true("velocity"), axis=1)[1:] < 0.01
    np.testing.assert_allclose(force[still].mean(axis=0), (0, 0, GRAVITY), atol=0.3)
    v, rate = true("wheel_speed")[1:, 0], true("angular_velocity")[1:, 2]
    assert np.corrcoef(force[:, 1], v * rate)[0, 1] > 0.9


def test_truth_is_read_back(clean: Path) -> None:
    truth, world = read_truth_map(clean), small_world()
    time, messages = zip(*BagLog(clean).messages(WHEELS_TOPIC), strict=True)
    wheels = np.stack([points_from_message(message) for message in messages])
    assert wheels.dtype == WHEEL
    np.testing.assert_allclose(np.array(time) - START_NS / 1e9, true("time"), atol=5e-7)
    for name in ("kind", "load", "slip_ratio", "slip_angle"):
        np.testing.assert_array_equal(wheels[name], [getattr(s.truth, name) for s in samples()], err_msg=name)
    for name, columns in (("contact", ("x", "y", "z")), ("properties", GROUND_PROPERTIES)):
        found = np.stack([wheels[column] for column in columns], axis=2)
        np.testing.assert_array_equal(found, [getattr(s.truth, name) for s in samples()], err_msg=name)
    assert (truth.origin, truth.resolution) == (world.origin, world.resolution)
    np.testing.assert_array_equal(truth.layers["elevation"], world.elevation)
    for i, name in enumerate(GROUND_PROPERTIES):
        np.testing.assert_array_equal(truth.layers[name], world.properties[:, :, i])


def test_gear_events_mountings_and_images_are_read_back(tmp_path: Path) -> None:
    gears = np.repeat((1.0, 0.0, -1.0), 30)
    driven = [replace(s, gear=g, command=np.append(s.command, -1.0)) for s, g in zip(samples(), gears, strict=False)]
    driven[5] = replace(driven[5], events=("rollover", "left the world"))
    path = record(tmp_path / "drive.mcap", tuple(driven))
    gear = read_drive(path, load_rig("proving_ground_gear")).channels["gear"]
    np.testing.assert_array_equal(gear.values[:, 0], gears)
    log = BagLog(path)
    ((_, transforms),) = log.messages("/tf_static")
    (mounted,) = transforms.transforms
    assert (mounted.header.frame_id, mounted.child_frame_id) == ("base_link", "camera_front")
    assert (mounted.transform.translation.x, mounted.transform.rotation.x) == (1.0, -0.5)
    ((_, events),) = log.messages("/events")
    assert [(status.name, status.level) for status in events.status] == [("rollover", 2), ("left the world", 2)]
    ((at, image),) = log.messages("/camera/image/compressed")
    assert (at, image.format) == (1_700_000_000.25, "jpeg")


def test_imperfections_reach_the_log(tmp_path: Path, drive: Drive) -> None:
    flaws = {"pose_noise_m": 0.1, "pose_drift": 2.0, "extrinsic_error_deg": 3.0, "stamp_offset_ms": 40.0}
    path = record(tmp_path / "flawed.mcap", **flaws)
    flawed = read_drive(path, RIG)
    error = (flawed.channels["position"].values - true("position"))[:, :2]
    assert 0.09 < np.diff(error, axis=0).std() / np.sqrt(2) < 0.11
    assert 0.5 < np.abs(error[-100:].mean(axis=0)).max() < 20
    # Measurements in the body frame do not drift.
    for name in ("linear_velocity", "throttle", "steer_angle"):
        np.testing.assert_allclose(flawed.channels[name].values, drive.channels[name].values, atol=0.02, err_msg=name)
    ((_, message),) = BagLog(path).messages("/tf_static")
    rotation = message.transforms[0].transform.rotation
    inner = abs(np.dot((rotation.x, rotation.y, rotation.z, rotation.w), MOUNTING.orientation))
    assert np.degrees(2 * np.arccos(inner)) == pytest.approx(3.0)
    ((at, _),) = BagLog(path).messages("/camera/image/compressed")
    assert at == 1_700_000_000.29


def test_drift_of_a_parked_vehicle_is_a_random_walk_of_the_given_size() -> None:
    still = replace(samples()[0], orientation=Rotation.from_euler("ZYX", (1.0, 0.4, -0.3)).as_quat())

    def end(seed: int) -> VehicleSample:
        drift = Drift(2.0, np.random.default_rng(seed))
        return [drift.apply(replace(still, time=float(t))) for t in range(0, 61, 10)][-1]

    ends = [end(seed) for seed in range(200)]
    away = np.array([sample.position - still.position for sample in ends])
    turn = [(Rotation.from_quat(s.orientation) * Rotation.from_quat(still.orientation).inv()).as_rotvec() for s in ends]
    np.testing.assert_allclose(away[:, :2].std(axis=0), 2.0, rtol=0.15)
    np.testing.assert_allclose(np.degrees(turn).std(axis=0), (0, 0, 2.0), rtol=0.15, atol=1e-6)


@pytest.mark.parametrize("friction", [None, 0.7, 0.35])
def test_inspect_finds_no_fault_in_recorded_drives(tmp_path: Path, friction: float | None) -> None:
    driven = samples() if friction is None else simulated(60.0, round(friction < 0.5), friction)
    found = inspect_log(open_log(record(tmp_path / "drive.mcap", driven)), RIG)
    assert found.findings == ()
    assert found.usable


def through_bytes(message: object) -> object:
    store = message_types()
    return store.deserialize_cdr(bytes(store.serialize_cdr(message, message.__msgtype__)), message.__msgtype__)


def test_a_calibration_projects_as_its_camera_does() -> None:
    matrix = np.array([[500.0, 0.0, 320.5], [0.0, 510.0, 240.25], [0.0, 0.0, 1.0]])
    model = CameraModel(640, 480, matrix, (-0.2, 0.05, 0.001, -0.002, 0.01))
    message = through_bytes(camera_info_message(model, START_NS, "camera_front"))
    assert (message.width, message.height, message.distortion_model) == (640, 480, "plumb_bob")
    np.testing.assert_array_equal(message.d, model.distortion)
    np.testing.assert_array_equal(message.r, np.eye(3).reshape(-1))
    point = np.array([0.4, -0.2, 2.0])
    seen, _ = cv2.projectPoints(point[None], np.zeros(3), np.zeros(3), message.k.reshape(3, 3), np.zeros(5))
    projected = message.p.reshape(3, 4) @ np.append(point, 1)
    np.testing.assert_allclose(projected[:2] / projected[2], seen.reshape(2))


@pytest.mark.parametrize("n", [0, 50])
def test_a_scan_is_read_back(n: int) -> None:
    random = np.random.default_rng(0)
    xyz, intensity = random.normal(size=(n, 3)), random.random(n)
    ring, time = np.arange(n) % 7, np.linspace(0, 0.1, n)
    message = through_bytes(points_message(xyz, intensity, ring, time, START_NS, "lidar_top"))
    assert [field.name for field in message.fields] == ["x", "y", "z", "intensity", "ring", "t"]
    points = points_from_message(message)
    np.testing.assert_allclose(np.stack([points[c] for c in "xyz"], axis=1), xyz, rtol=1e-6)
    np.testing.assert_allclose(points["intensity"], intensity, rtol=1e-6)
    np.testing.assert_array_equal(points["ring"], ring)
    np.testing.assert_allclose(points["t"] / 1e9, time, atol=1e-9)
