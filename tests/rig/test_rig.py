"""Presets, errors in rig files in one line, and what rigs derive from their entries."""

import numpy as np
import pytest

from factories import RIG, small_rig
from offpiste.core.errors import RigError
from offpiste.rig.channels import unit_factor
from offpiste.rig.outputs import Timeouts
from offpiste.rig.rig import VARIANTS, load_rig, parse_rig, preset_names, rig_text
from offpiste.rig.sensors import Mounting
from offpiste.runtime.settings import RuntimeSettings

GYRO = '[channels.angular_velocity]\ntopic = "o"\nfields = ["a", "b", "c"]\n'
CAMERA = '[cameras.front]\ntopic = "/front"\ninfo = "/front/info"\n'
LIDAR = '[lidars.top]\ntopic = "/points"\n'
LENS = "[cameras.front.intrinsics]\nwidth = 8\nheight = 6\nfocal_length = [5.0, 5.0]\ncentre = [3.5, 2.5]\n"
OUTPUT = """
[outputs.a]
topic = "/a"
type = "geometry_msgs/msg/Twist"
[outputs.a.fields]
"linear.x" = { of = "speed" }
"""
GEAR = '[channels.gear]\ntopic = "box"\nfields = ["x"]\nvalues = { "D" = 1, "true" = 0, "2" = -1 }\n'


def edited(old: str, new: str) -> str:
    assert old in RIG
    return RIG.replace(old, new)


def steering(entry: str) -> str:
    return edited('fields = ["steer"]', entry)


def output(old: str, new: str) -> str:
    assert old in OUTPUT
    return RIG + OUTPUT.replace(old, new)


WRONG = [
    (RIG + "[", "not valid TOML"),
    # Keys and types.
    (edited("max_steer", "max_stear"), "vehicle: .*`max_stear`; did you mean 'max_steer'"),
    (edited("[vehicle]", "[vehicel]"), "did you mean 'vehicle'"),
    ("colour = 1\n" + RIG, "`colour`"),
    (RIG + "scael = 2.0\n", "channels.steer: .*`scael`; did you mean 'scale'"),
    (RIG + '[clock]\nstamps = "heder"\n', "clock.stamps is 'heder'.*did you mean 'header'"),
    (RIG + "[channels.steer.wrap]\nperoid = 1.0\n", "channels.steer.wrap: .*did you mean 'period'"),
    (RIG + CAMERA + "exposure = 1\n", "cameras.front: .*`exposure`"),
    (RIG + "[live.timeouts]\nscann = 1.0\n", "live.timeouts: .*did you mean 'scan'"),
    (RIG + 'sign = "left"\n', "channels.steer.sign is 'left': expected `int`, got `str`"),
    (RIG + "sign = 2\n", "channels.steer.sign is 2"),
    (edited('name = "small"', ""), "`name`"),
    (edited("mass = 800.0", 'mass = "heavy"'), "vehicle.mass is 'heavy': expected a number"),
    (edited(", [0.0, -0.6]]", "]"), "vehicle.wheel_positions: expected a list of length 4"),
    (RIG + '[motion]\nnormals = "body"\n', "motion.normals is 'body'"),
    (RIG + GYRO + 'frame = "map"\n', "channels.angular_velocity.frame is 'map'"),
    (RIG + LIDAR + 'time_unit = "minutes"\n', "lidars.top.time_unit is 'minutes'"),
    # Bounds.
    (edited("mass = 800.0", "mass = 0.0"), "vehicle.mass is 0.0: expected a number > 0"),
    (edited("mass = 800.0", "mass = nan"), "vehicle.mass is nan: expected a finite number"),
    (edited(", [0.0, -0.6]]", ", [0.0, nan]]"), "vehicle.wheel_positions.3..1. is nan"),
    (edited(", [0.0, -0.6]]", ", [0.0, -4e8]]"), "vehicle.wheel_positions.3..1. is -4"),
    (RIG + "[clock]\nmax_gap = 0.0\n", "clock.max_gap is 0.0"),
    (RIG + "[motion]\nwindow = -0.2\n", "motion.window is -0.2"),
    (RIG + CAMERA + "bits = 20\n", "cameras.front.bits is 20: .* <= 16"),
    (RIG + CAMERA + "own_body = [[[0, 0], [1, 1]]]\n", "cameras.front.own_body.0.: expected a list of length >= 3"),
    (RIG + CAMERA.replace('info = "/front/info"', "") + LENS.replace("[5.0,", "[0.0,"), "focal_length.0. is 0.0"),
    (RIG + LIDAR + "delay = nan\n", "lidars.top.delay is nan"),
    (output('"speed" }', '"speed", ahead = 9 }'), 'outputs.a.fields."linear.x".ahead is 9'),
    (RIG + "[live.limits]\nsteer_rate = 0\n", "live.limits.steer_rate is 0"),
    (RIG + "[live.limits]\nthrottle = 2\n", "live.limits.throttle is 2: .* <= 1"),
    (RIG + "[live.limits]\nspeed = nan\n", "live.limits.speed is nan"),
    (RIG + "[live.timeouts]\nstate = 0\n", "live.timeouts.state is 0: .* >= 0.04"),
    (RIG + "[live.timeouts]\nplan = 0.08\n", "live.timeouts.plan is 0.08: .* >= 0.2"),
    (RIG + '[live.enable]\ntopic = "/e"\ntimeout = 0\n', "live.enable.timeout is 0"),
    (RIG + CAMERA + "bits = 4\n", "cameras.front.bits is 4"),
    (
        RIG + CAMERA + CAMERA.replace("front]", "rear]") + "bits = 20\n" + LIDAR + 'time_unit = "minutes"\n',
        "cameras.rear.bits is 20",
    ),
    # Names of topics, types and fields.
    (output('"/a"', '"/a\\n"'), "outputs.a.topic is .*: expected a topic such as"),
    (output('"/a"', '"a b"'), "outputs.a.topic is 'a b': expected a topic such as"),
    (output("/msg/", "/"), "outputs.a.type is 'geometry_msgs/Twist': expected a type such as"),
    (output('"speed"', '"sped"'), 'outputs.a.fields."linear.x".of is \'sped\'.*did you mean \'speed\''),
    (output("linear.x", "linear x"), 'outputs.a.fields."linear x": expected a field path such as'),
    (RIG + OUTPUT.split('"linear')[0], "outputs.a.fields: expected a table of length >= 1"),
    (RIG + '[live.types]\n"/odom" = "Odometry"\n', "live.types.\"/odom\" is 'Odometry': expected a type"),
    (RIG + '[live.types]\n"odom" = "a/msg/B"\n', "live.types.odom: expected a topic"),
    # Vehicles.
    (edited("[2.2, 0.6], [2.2, -0.6]", "[2.2, -0.6], [2.2, 0.6]"), "left and right exchanged; left is .y"),
    (edited("[0.0, 0.6], [0.0, -0.6]", "[0.0, -0.6], [0.0, 0.6]"), "left and right exchanged"),
    (edited("[[2.2, 0.6], [2.2, -0.6]", "[[-3.1, 0.6], [-3.1, -0.6]"), "front wheels are not ahead"),
    (edited("max_steer = 0.4", "max_steer = 23.0"), "max_steer is 23.0 rad.*below pi/2"),
    # Channels.
    (edited("[channels.brake]", "[channels.break]"), "unknown channel 'break'; did you mean 'brake'"),
    (edited('"steer_angle",', '"steer_angel",'), "unknown channel 'steer_angel'; did you mean 'steer_angle'"),
    (edited('["x", "y", "z"]', '["x"]'), "channels.position.fields has 1 .* 2 or 3"),
    (RIG + 'unit = "m/s"\n', "does not measure steer; use one of: 1, percent, .* rad, deg"),
    (RIG + "origin = [48.0, 11.0]\n", "steer.origin is given, and the unit is not 'lat lon'"),
    (
        edited("[channels.orientation]", 'unit = "lat lon"\norigin = [411.0, 48.0]\n[channels.orientation]'),
        "channels.position.origin.0. is 411.0: .* <= 90",
    ),
    (
        edited("[channels.orientation]", '[channels.orientation]\ninterpolation = "on change"'),
        "channels.orientation is a measurement.*controls and actuators only",
    ),
    (RIG + GYRO, "channels.angular_velocity.frame is missing.*world.*body"),
    (edited('"steer_angle",', '"steer_angle", "steer",'), "'steer' is both given and declared absent"),
    (edited('"steer_rate",', ""), "'steer_rate' is neither given nor declared absent"),
    (edited("[channels.position]", "[channels.wheel_speed]").replace('"y", "z"', '"y"'), "position is missing"),
    (edited("[channels.orientation]", "[channels.wheel_speed]"), "channels.orientation or channels.yaw is missing"),
    (RIG + GEAR.replace('"D"', '"reverse"'), "values has a key 'reverse' that is not a recorded number"),
    (
        RIG + GEAR.replace("gear", "linear_velocity").replace('["x"]', '["x", "y"]') + 'frame = "body"\n',
        "channels.linear_velocity.values needs a single field",
    ),
    (RIG + '[channels.yaw_rate]\ntopic = "x"\nfields = ["x"]\nabsolute = true\n', "channels.yaw_rate.absolute"),
    (steering('fields = ["turn", "speed"]'), "channels.steer has 2 fields in '1'"),
    (steering('fields = ["turn", "speed"]\nunit = "rad"'), "channels.steer has 2 fields in 'rad'"),
    (steering('fields = ["turn"]\nunit = "rad/s"'), "channels.steer has 1 field in 'rad/s'"),
    (steering('fields = ["turn", "speed", "x"]\nunit = "rad/s"'), "channels.steer.fields has 3 entries"),
    # Sensors.
    (RIG + '[cameras.front]\ntopic = "/front"\n', "cameras.front has no calibration"),
    (RIG + CAMERA + LENS, "cameras.front has two calibrations"),
    (
        RIG + LIDAR + "[lidars.top.body_from_lidar]\nposition = [0, 0, 1]\norientation = [0, 0, 0, 2]\n",
        "body_from_lidar.orientation is not a unit quaternion",
    ),
    (RIG + LIDAR + "min_range = 5.0\nmax_range = 2.0\n", "min_range 5.0 is not below max_range 2.0"),
    (RIG + LIDAR + "own_body = [[1, 1, 1], [0, 0, 0]]\n", "own_body is not a box"),
    (RIG + CAMERA + LIDAR.replace("lidars.top", "lidars.front"), "'front' is both a camera and a LiDAR"),
    (
        RIG + LIDAR + 'time_field = "t"\ntime_origin = "epoch"\n[clock]\nstamps = "receive"\n',
        'lidars.top.time_origin is "epoch" and clock.stamps is "receive"',
    ),
    # Outputs.
    (output('"speed" }', '"speed", scale = 0 }'), r'"linear.x"\.scale is 0'),
    (output('"speed" }', '"speed", unit = "rad" }'), "'rad' does not measure"),
    (output('"speed" }', '"steer", unit = "rad/s" }'), "'rad/s' is a unit of turn rates.*yaw_rate"),
    (output('"speed" }', '"speed", clip = [1, 0] }'), "clip is not an interval"),
    (RIG + OUTPUT + OUTPUT.replace("outputs.a", "outputs.b"), "two outputs use the same topic"),
    (RIG + OUTPUT + "[live.limits]\nthrottle = 0.5\n", "live.limits.throttle has no effect"),
    (RIG + "[live.timeouts]\nscan = 2\n", "live.timeouts.scan is above scan_limit"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), WRONG)
def test_mistakes_are_named_with_the_file_in_one_line(text, message, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(RigError, match=message) as error:
        load_rig(path)
    assert "mine.toml" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_rig_that_does_not_exist_is_an_error_that_lists_the_presets(tmp_path):
    for name in ("tartandrive3", str(tmp_path / "no.toml"), str(tmp_path)):
        with pytest.raises(RigError, match=r"no such rig.*tartandrive2"):
            load_rig(name)


@pytest.mark.parametrize("name", preset_names())
def test_presets_load_and_describe_a_vehicle(name):
    rig = load_rig(name)
    assert rig.name == name
    assert 0.05 < rig.vehicle.wheelbase < 10
    assert rig.wheel_positions().shape == (4, 2)
    variant = VARIANTS.get(name, {"of": name, "changes": ()})
    assert all(rig_text(variant["of"]).count(old) == 1 for old, _ in variant["changes"])


def test_a_rig_file_loads_with_its_defaults_and_with_paths_beside_it(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(RIG)
    rig = load_rig(path)
    assert rig == small_rig()
    assert rig.vehicle.wheelbase == pytest.approx(2.2)
    assert rig.without_slope().motion.normals == "flat"
    assert rig.without_slope().channels == rig.channels
    assert rig.live.timeouts == RuntimeSettings().timeouts
    path.write_text(
        RIG
        + CAMERA
        + 'mask = "front.png"\n[live]\ndefinitions = ["my_msgs/msg/Drive.msg"]\n[live.timeouts]\nstate = 0.25'
    )
    rig = load_rig(path)
    assert rig.cameras["front"].mask == str(tmp_path / "front.png")
    assert rig.live.definitions == (str(tmp_path / "my_msgs/msg/Drive.msg"),)
    assert rig.live.timeouts == Timeouts(state=0.25)


def test_a_steering_rate_follows_from_a_steering_angle():
    angle = '[channels.steer_angle]\ntopic = "steering"\nfields = ["angle"]\n'
    rig = parse_rig(edited('"steer_angle", "steer_rate", ', "") + angle, where="test")
    assert "steer_rate" not in {*rig.channels, *rig.absent}


def test_a_gear_is_optional_and_a_column_of_its_own():
    assert [control.name for control in small_rig().controls] == ["throttle", "brake", "steer"]
    rig = small_rig(GEAR)
    assert [control.name for control in rig.controls] == ["throttle", "brake", "steer", "gear"]
    assert rig.channels["gear"].meanings() == {68.0: 1, 1.0: 0, 2.0: -1}


def test_a_turn_rate_comes_with_a_speed():
    rig = parse_rig(steering('fields = ["turn", "speed"]\nunit = "rad/s"'), where="test")
    assert rig.channels["steer"].turns
    assert not small_rig().channels["steer"].turns


@pytest.mark.parametrize(
    ("channel", "unit", "max_steer", "factor"),
    [
        ("steer_angle", "deg", 0, np.pi / 180), ("linear_velocity", "km/h", 0, 1 / 3.6),
        ("yaw_rate", "rev/min", 0, 2 * np.pi / 60), ("engine_rpm", "rev/min", 0, 1e-3),
        ("engine_rpm", "rad/s", 0, 60 / (2 * np.pi * 1000)), ("throttle", "percent", 0, 0.01), ("position", "", 0, 1),
        ("steer", "deg", 0.5, np.pi / 180 / 0.5), ("steer", "", 0.5, 1), ("steer", "1", 0.5, 1),
    ],
)  # fmt: skip
def test_units_are_converted_to_si(channel, unit, max_steer, factor):
    assert unit_factor(channel, unit, max_steer) == pytest.approx(factor)


def test_orientations_and_rough_guesses_give_the_same_axes():
    optical = (-0.5, 0.5, -0.5, 0.5)
    matrix = Mounting((1.0, 2.0, 3.0), optical).matrix()
    ahead, right, down = matrix[:3, 2], matrix[:3, 0], matrix[:3, 1]
    np.testing.assert_allclose([ahead, right, down], [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=1e-12)
    np.testing.assert_allclose(matrix[:3, 3], [1, 2, 3])
    forward = Mounting(looks="forward").matrix(optical=True)
    np.testing.assert_allclose(forward, Mounting((0.0, 0.0, 0.0), optical).matrix(), atol=1e-12)
    left = Mounting(looks="left")
    np.testing.assert_allclose(left.matrix()[:3, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(left.matrix(optical=True)[:3, :3] @ [0, 0, 1], [0, 1, 0], atol=1e-12)


def test_the_proving_grounds_rig_masks_what_its_cameras_see_of_the_vehicle():
    from offpiste.perception.camera import mask_from_polygons
    from offpiste.simulation.sensors.camera import Camera
    from offpiste.simulation.sensors.suite import full_suite

    rig = load_rig("proving_ground")
    for settings in full_suite().cameras[:2]:
        camera = Camera(settings)
        own = camera.in_rows(camera.own.distance)
        mask = mask_from_polygons(rig.cameras[settings.name].own_body, *settings.model.size)
        seen = np.isfinite(own) & (own < 100)
        assert (seen & ~mask).sum() < 0.02 * seen.sum()
        assert (mask & ~seen).mean() < 0.01
