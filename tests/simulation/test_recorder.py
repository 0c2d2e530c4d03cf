"""Recording and reading back of drives, and inspection of clean and faulty ones."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from offpiste.core.conventions import GRAVITY
from offpiste.inspection.inspect import Inspection, inspect_log
from offpiste.logs import Drive, open_log, read_drive
from offpiste.logs.formats.bag import BagLog
from offpiste.logs.ground_truth import GROUND_KINDS, GROUND_PROPERTIES, read_truth
from offpiste.logs.ros.sensor_messages import points_from_message
from offpiste.logs.ros.writer import McapWriter, header, message_types
from offpiste.rig.camera import CameraModel
from offpiste.rig.rig import load_rig
from offpiste.simulation.messages import (
    START_NS,
    Mounting,
    camera_info_message,
    image_message,
    points_message,
    stamp_ns,
    vehicle_messages,
)
from offpiste.simulation.recorder import Drift, Imperfections, Recorder, with_noise
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.vehicle.parameters import load_vehicle
from synthetic_drive import samples, simulated, small_world

RIG = load_rig("proving_ground")
RADIUS = load_vehicle().rolling_radius
CAMERA = Mounting("camera_front", (1.0, 0.0, 1.2), (-0.5, 0.5, -0.5, 0.5))


def record(path: Path, *, seconds: float = 60.0, seed: int = 0, **flaws: float) -> Path:
    with McapWriter(path) as writer:
        rng, imperfections = np.random.default_rng(seed), Imperfections(**flaws)
        recorder = Recorder(writer, wheel_radius=RADIUS, rng=rng, imperfections=imperfections)
        recorder.start(small_world(), [CAMERA])
        for sample in samples(seconds):
            recorder.vehicle(sample)
    return path


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recorded") / "drive.mcap")


@pytest.fixture(scope="module")
def drive(clean: Path) -> Drive:
    return read_drive(clean, RIG)


def true(attribute: str) -> np.ndarray:
    return np.array([getattr(sample, attribute) for sample in samples()])


def test_stamps_are_the_samples_times_since_a_fixed_moment(drive: Drive) -> None:
    assert drive.notes == ()
    for channel in drive.channels.values():
        np.testing.assert_allclose(channel.time - START_NS / 1e9, true("time"), atol=5e-7)


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
def test_channels_are_what_was_written_in_unit_and_sign(
    drive: Drive, channel: str, expected: np.ndarray, sigma: float
) -> None:
    error = drive.channels[channel].values - expected
    if sigma == 0:
        np.testing.assert_allclose(error, 0, atol=1e-7)  # float32
    else:
        np.testing.assert_allclose(error.std(axis=0), sigma, rtol=0.1)
        np.testing.assert_allclose(error.mean(axis=0), 0, atol=0.1 * sigma)


def test_imu_feels_gravity_and_the_turn(clean: Path) -> None:
    log = BagLog(clean)
    fields = [f"linear_acceleration.{axis}" for axis in "xyz"]
    force = log.read("/imu", fields).values
    still = np.linalg.norm(true("velocity"), axis=1)[1:] < 0.01
    np.testing.assert_allclose(force[still].mean(axis=0), (0, 0, GRAVITY), atol=0.3)
    v, rate = true("wheel_speed")[1:, 0], true("angular_velocity")[1:, 2]
    assert np.corrcoef(force[:, 1], v * rate)[0, 1] > 0.9


def test_truth_comes_back(clean: Path) -> None:
    truth, world = read_truth(clean), small_world()
    known = [sample.truth for sample in samples()]
    np.testing.assert_allclose(truth.time - START_NS / 1e9, true("time"), atol=5e-7)
    for name in ("contact", "properties", "kind", "load", "slip_ratio", "slip_angle"):
        np.testing.assert_array_equal(getattr(truth, name), [getattr(t, name) for t in known], err_msg=name)
    assert truth.map.origin == world.origin
    assert truth.map.resolution == world.resolution
    np.testing.assert_array_equal(truth.map.layers["elevation"], world.elevation)
    for i, name in enumerate(GROUND_PROPERTIES):
        np.testing.assert_array_equal(truth.map.layers[name], world.properties[:, :, i])
    assert set(GROUND_KINDS) <= set(truth.map.layers)


def test_the_gear_comes_back(tmp_path: Path) -> None:
    gears = (1.0, 0.0, -1.0)
    with McapWriter(tmp_path / "geared.mcap") as writer:
        for i, sample in enumerate(samples()[:90]):
            geared = replace(sample, gear=gears[i // 30], command=np.append(sample.command, -1.0))
            for topic, message in vehicle_messages(geared, stamp_ns(sample.time), wheel_radius=RADIUS).items():
                writer.write(topic, message, stamp_ns(sample.time))
    drive = read_drive(tmp_path / "geared.mcap", load_rig("proving_ground_gear"))
    np.testing.assert_array_equal(drive.channels["gear"].values[:, 0], np.repeat(gears, 30))
    np.testing.assert_array_equal(drive.channels["gear"].time, drive.channels["steer"].time)


def test_mountings_events_and_sensors(tmp_path: Path) -> None:
    with McapWriter(tmp_path / "drive.mcap") as writer:
        recorder = Recorder(writer, wheel_radius=RADIUS, rng=np.random.default_rng(0))
        recorder.start(small_world(), [CAMERA])
        recorder.vehicle(replace(samples()[0], events=("rollover", "left the world")))
        stamp = recorder.sensor_stamp_ns(0.25)
        recorder.sensor("/camera/image/compressed", image_message(np.zeros((4, 6, 3), np.uint8), stamp, CAMERA.frame))
    log = BagLog(tmp_path / "drive.mcap")
    ((_, transforms),) = log.messages("/tf_static")
    (mounted,) = transforms.transforms
    assert (mounted.header.frame_id, mounted.child_frame_id) == ("base_link", "camera_front")
    assert (mounted.transform.translation.x, mounted.transform.rotation.x) == (1.0, -0.5)
    ((_, events),) = log.messages("/events")
    assert [(status.name, status.level) for status in events.status] == [("rollover", 2), ("left the world", 2)]
    ((at, image),) = log.messages("/camera/image/compressed")
    assert (at, image.format) == (1_700_000_000.25, "jpeg")


def test_imperfections_reach_the_log(tmp_path: Path, drive: Drive) -> None:
    path = record(tmp_path / "flawed.mcap", pose_noise_m=0.1, pose_drift=2.0, extrinsic_error_deg=3.0)
    flawed = read_drive(path, RIG)
    error = (flawed.channels["position"].values - true("position"))[:, :2]
    assert 0.09 < np.diff(error, axis=0).std() / np.sqrt(2) < 0.11
    assert 0.5 < np.abs(error[-100:].mean(axis=0)).max() < 20
    # What is measured in the body's frame does not drift.
    for name in ("linear_velocity", "throttle", "steer_angle"):
        np.testing.assert_allclose(flawed.channels[name].values, drive.channels[name].values, atol=0.02, err_msg=name)
    ((_, message),) = BagLog(path).messages("/tf_static")
    rotation = message.transforms[0].transform.rotation
    inner = abs(np.dot((rotation.x, rotation.y, rotation.z, rotation.w), CAMERA.rotation))
    assert np.degrees(2 * np.arccos(inner)) == pytest.approx(3.0)
    with McapWriter(tmp_path / "late.mcap") as writer:
        late = Recorder(
            writer, wheel_radius=RADIUS, rng=np.random.default_rng(0), imperfections=Imperfections(stamp_offset_ms=40.0)
        )
        assert late.sensor_stamp_ns(1.0) == START_NS + 1_040_000_000


# inspect


def serious(found: Inspection) -> list[str]:
    return [str(f) for f in found.findings if f.severity != "note"]


def test_inspect_finds_no_fault_in_a_clean_drive(clean: Path) -> None:
    found = inspect_log(open_log(clean), RIG)
    assert found.findings == ()
    assert found.usable
    guessed = inspect_log(open_log(clean))
    assert serious(guessed) == []
    assert "steer" in {f.where for f in guessed.findings}, "the joints' names tell which topic steers"


@pytest.mark.parametrize(("seed", "friction"), [(0, 0.7), (1, 0.35)])
def test_inspect_finds_no_fault_in_a_drive_of_the_simulated_vehicle(tmp_path: Path, seed: int, friction: float) -> None:
    found = faulty(tmp_path / "drive.mcap", drive=simulated(60.0, seed, friction))
    assert found.findings == ()
    assert found.summary.distance > 200


Edit = Callable[[int, VehicleSample], VehicleSample]


def faulty(
    path: Path,
    *,
    drive: tuple[VehicleSample, ...] | None = None,
    edit: Edit = lambda _, s: s,
    late: str = "",
    by: float = 0.0,
    lost: str = "",
    drop: range = range(0),
) -> Inspection:
    """A drive of the simulated vehicle with samples changed, one topic stamped late, or rows of one topic dropped."""
    rng = np.random.default_rng(0)
    with McapWriter(path) as writer:
        for i, sample in enumerate(drive or simulated(40.0)):
            measured = with_noise(edit(i, sample), Imperfections(), rng)
            messages = vehicle_messages(measured, stamp_ns(sample.time), wheel_radius=RADIUS)
            if late:
                messages[late].header = header(stamp_ns(sample.time + by), "base_link")
            for topic, message in messages.items():
                if topic != lost or i not in drop:
                    writer.write(topic, message, stamp_ns(sample.time))
    return inspect_log(open_log(path), RIG)


@pytest.mark.parametrize(
    ("fault", "where", "what", "remedy"),
    [
        (
            {"edit": lambda _, s: replace(s, command=s.command * (1, 1, -1))},
            "steer", "is positive to the right", "channels.steer.sign = -1",
        ),
        (
            {"edit": lambda _, s: replace(s, brake_pressure=100 * s.brake_pressure)},
            "brake_pressure", "leaves its range", "channels.brake_pressure.",
        ),
        ({"late": "/command", "by": 0.6}, "/command", "clock is apart from the others'", 'clock.stamps = "receive"'),
        ({"late": "/wheels", "by": 0.4}, "/wheels", "is late", "channels.wheel_speed.delay = 0."),
        ({"lost": "/steering", "drop": range(800, 900)}, "/steering", "has a gap", "the drive is cut there"),
    ],
)  # fmt: skip
def test_inspect_finds_each_planted_fault_in_its_channel(
    tmp_path: Path, fault: dict, where: str, what: str, remedy: str
) -> None:
    found = faulty(tmp_path / "drive.mcap", **fault).findings
    assert [f for f in found if f.where == where and what in f.what and remedy in f.remedy], found
    # Nothing else is accused, but for the other commands of a late message.
    beside = {"throttle", "brake"} if "late" in fault else set()
    assert {f.where for f in found if f.severity != "note"} <= {where} | beside, found


STILL = replace(samples()[0], orientation=Rotation.from_euler("ZYX", (1.0, 0.4, -0.3)).as_quat())


def test_drift_of_a_parked_vehicle_is_a_random_walk_of_the_stated_size() -> None:
    def end(seed: int) -> VehicleSample:
        drift = Drift(2.0, np.random.default_rng(seed))
        return [drift.apply(replace(STILL, time=float(t))) for t in range(0, 61, 10)][-1]

    ends = [end(seed) for seed in range(200)]
    away = np.array([sample.position - STILL.position for sample in ends])
    turn = [(Rotation.from_quat(s.orientation) * Rotation.from_quat(STILL.orientation).inv()).as_rotvec() for s in ends]
    np.testing.assert_allclose(away[:, :2].std(axis=0), 2.0, rtol=0.15)
    np.testing.assert_allclose(np.degrees(turn).std(axis=0), (0, 0, 2.0), rtol=0.15, atol=1e-6)


STAMP = 1_700_000_000_250_000_000


def through_bytes(message: object) -> object:
    store = message_types()
    return store.deserialize_cdr(bytes(store.serialize_cdr(message, message.__msgtype__)), message.__msgtype__)


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
