"""Presets, and errors in rig files in one line."""

import numpy as np
import pytest

from factories import RIG, small_rig
from offpiste.core.errors import RigError
from offpiste.rig.channels import unit_factor
from offpiste.rig.rig import load_rig, parse_rig, preset_names

GYRO = '[channels.angular_velocity]\ntopic = "o"\nfields = ["a", "b", "c"]\n'


def edited(old: str, new: str, more: str = "") -> str:
    assert old in RIG
    return RIG.replace(old, new) + more


WRONG = {
    "not TOML": (RIG + "[", r"not valid TOML"),
    "unknown key": (edited("max_steer", "max_stear"), r"max_stear|max_steer"),
    "unknown top key": ("colour = 1\n" + RIG, r"`colour`"),
    "unknown key of a channel": (RIG + "gain = 2.0\n", r"channels\.\w+: .*`gain`"),
    "wrong type in a channel": (RIG + 'sign = "left"\n', r"got `str` - at `channels\.steer\.sign`"),
    "missing key": (edited('name = "small"', ""), r"`name`"),
    "wrong type": (edited("mass = 800.0", 'mass = "heavy"'), r"mass"),
    "a wheel nowhere": (edited(", [0.0, -0.6]]", ", [0.0, nan]]"), r"wheel_positions hold an impossible position"),
    "a wheel on the moon": (edited(", [0.0, -0.6]]", ", [0.0, -4e8]]"), r"wheel_positions hold an impossible position"),
    "left wheels on the right": (
        edited("[2.2, 0.6], [2.2, -0.6]", "[2.2, -0.6], [2.2, 0.6]"),
        r"wheel_positions have left and right exchanged; left is \+y",
    ),
    "right wheels behind on the left": (
        edited("[0.0, 0.6], [0.0, -0.6]", "[0.0, -0.6], [0.0, 0.6]"),
        r"wheel_positions have left and right exchanged",
    ),
    "three wheels": (edited(", [0.0, -0.6]]", "]"), r"wheel_positions"),
    "unknown channel": (edited("[channels.brake]", "[channels.break]"), r"unknown channel 'break'.*brake"),
    "wrong number of fields": (edited('["x", "y", "z"]', '["x"]'), r"channels\.position\.fields has 1 .* 2 or 3"),
    "wrong unit": (
        RIG + 'unit = "m/s"\n',
        r"does not measure steer; use one of: 1, percent, .* rad, deg",
    ),
    "an origin of metres": (
        RIG + "origin = [48.0, 11.0]\n",
        r"steer\.origin is not valid for a position in 'lat lon'",
    ),
    "an origin off the earth": (
        edited("[channels.orientation]", 'unit = "lat lon"\norigin = [411.0, 48.0]\n[channels.orientation]'),
        r"channels\.position\.origin is not valid.*latitude and longitude in degrees",
    ),
    "a heading on change": (
        edited("[channels.orientation]", '[channels.orientation]\ninterpolation = "on change"'),
        r"channels\.orientation is a measurement.*controls and actuators only",
    ),
    "no frame": (RIG + GYRO, r"channels\.angular_velocity\.frame is missing.*world.*body"),
    "unknown frame": (RIG + GYRO + 'frame = "map"\n', r"map"),
    "sign of two": (RIG + "sign = 2\n", r"sign"),
    "given and absent": (edited('"steer_angle",', '"steer_angle", "steer",'), r"'steer' is both given and .*absent"),
    "unknown absent": (edited('"steer_angle",', '"steer_angle", "wings",'), r"unknown channel 'wings'"),
    "no position": (edited("[channels.position]", "[channels.wheel_speed]").replace('"y", "z"', '"y"'), r"position"),
    "no heading": (
        edited("[channels.orientation]", "[channels.wheel_speed]"),
        r"channels\.orientation or channels\.yaw is missing",
    ),
    "neither given nor absent": (edited('"steer_rate",', ""), r"'steer_rate' is neither given nor declared absent"),
    "no mass": (edited("mass = 800.0", "mass = 0.0"), r"vehicle\.mass is 0\.0 kg"),
    "mass is no number": (edited("mass = 800.0", "mass = nan"), r"vehicle\.mass is nan kg"),
    "wheels swapped": (
        edited("[[2.2, 0.6], [2.2, -0.6]", "[[-3.1, 0.6], [-3.1, -0.6]"),
        r"front wheels are not ahead",
    ),
    "steering in degrees": (edited("max_steer = 0.4", "max_steer = 23.0"), r"max_steer is 23\.0 rad.*below pi/2"),
    "gap of nothing": (RIG + "[clock]\nmax_gap = 0.0\n", r"clock\.max_gap is 0\.0"),
    "window backwards": (RIG + "[motion]\nwindow = -0.2\n", r"motion\.window is -0\.2"),
    "unknown normals": (RIG + '[motion]\nnormals = "body"\n', r"body"),
}


@pytest.mark.parametrize("case", WRONG)
def test_mistakes_are_named_with_the_file_in_one_line(case, tmp_path):
    text, message = WRONG[case]
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(RigError, match=message) as error:
        load_rig(path)
    assert "mine.toml" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        (edited("max_steer", "max_stear"), "max_steer"),
        (edited("[vehicle]", "[vehicel]"), "vehicle"),
        (RIG + "scael = 2.0\n", "scale"),
        (RIG + '[clock]\nstamps = "heder"\n', "header"),
        (RIG + "[channels.steer.wrap]\nperoid = 1.0\n", "period"),
        (edited("[channels.brake]", "[channels.break]"), "brake"),
        (edited('"steer_angle",', '"steer_angel",'), "steer_angle"),
        (RIG + "[live.timeouts]\nscann = 1.0\n", "scan"),
    ],
)
def test_a_misspelled_name_is_answered_by_the_nearest_one(text, meant):
    with pytest.raises(RigError, match=f"did you mean '{meant}'"):
        parse_rig(text, where="test")


def test_a_rig_that_does_not_exist_is_an_error_that_lists_the_presets(tmp_path):
    for name in ("tartandrive3", str(tmp_path / "no.toml"), str(tmp_path)):
        with pytest.raises(RigError, match=r"no such rig.*tartandrive2"):
            load_rig(name)


@pytest.mark.parametrize("name", preset_names())
def test_presets_load_and_describe_a_vehicle(name):
    rig = load_rig(name)
    assert rig.name
    assert 0.05 < rig.vehicle.wheelbase < 10
    assert rig.wheel_positions().shape == (4, 2)
    front_left, front_right = rig.wheel_positions()[:2]
    assert front_left[1] > front_right[1]


def test_a_rig_file_loads_with_its_defaults(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(RIG)
    rig = load_rig(path)
    assert rig == small_rig()
    assert rig.vehicle.wheelbase == pytest.approx(2.2)
    assert rig.channels["steer"].interpolation == "linear"
    assert rig.without_slope().motion.normals == "flat"
    assert rig.without_slope().channels == rig.channels


def test_a_steering_rate_follows_from_a_steering_angle():
    angle = '[channels.steer_angle]\ntopic = "steering"\nfields = ["angle"]\n'
    rig = parse_rig(edited('"steer_angle", "steer_rate", ', "", angle), where="test")
    assert "steer_rate" not in {*rig.channels, *rig.absent}


def test_a_gear_is_optional_and_a_column_of_its_own():
    assert [control.name for control in small_rig().controls] == ["throttle", "brake", "steer"]
    gear = '[channels.gear]\ntopic = "box"\nfields = ["x"]\nvalues = { "D" = 1, "true" = 0, "2" = -1 }\n'
    rig = small_rig(gear)
    assert [control.name for control in rig.controls] == ["throttle", "brake", "steer", "gear"]
    assert rig.channels["gear"].meanings() == {68.0: 1, 1.0: 0, 2.0: -1}
    with pytest.raises(RigError, match=r"values has a key 'reverse' that is not a recorded number"):
        small_rig(gear.replace('"D"', '"reverse"'))
    with pytest.raises(RigError, match=r"channels.linear_velocity.values needs a single field"):
        small_rig(gear.replace("gear", "linear_velocity").replace('["x"]', '["x", "y"]') + 'frame = "body"\n')


@pytest.mark.parametrize(
    ("entry", "what"),
    [
        ('fields = ["turn", "speed"]', r"channels.steer has 2 fields in '1'"),
        ('fields = ["turn", "speed"]\nunit = "rad"', r"channels.steer has 2 fields in 'rad'"),
        ('fields = ["turn"]\nunit = "rad/s"', r"channels.steer has 1 field in 'rad/s'"),
        ('fields = ["turn", "speed", "x"]\nunit = "rad/s"', r"channels.steer.fields has 3 entries"),
    ],
)
def test_a_turn_rate_comes_with_a_speed_and_nothing_else_does(entry, what):
    with pytest.raises(RigError, match=what):
        parse_rig(edited('fields = ["steer"]', entry), where="test")
    right = parse_rig(edited('fields = ["steer"]', 'fields = ["turn", "speed"]\nunit = "rad/s"'), where="test")
    assert right.channels["steer"].turns
    assert not small_rig().channels["steer"].turns


def test_only_a_control_has_a_size_without_its_sign():
    entry = '[channels.yaw_rate]\ntopic = "x"\nfields = ["x"]\nabsolute = true\n'
    with pytest.raises(RigError, match=r"channels.yaw_rate.absolute"):
        small_rig(entry)
    assert not small_rig().channels["steer"].absolute


def test_units_are_converted_to_si():
    assert unit_factor("steer_angle", "deg") == pytest.approx(np.pi / 180)
    assert unit_factor("linear_velocity", "km/h") == pytest.approx(1 / 3.6)
    assert unit_factor("yaw_rate", "rev/min") == pytest.approx(2 * np.pi / 60)
    assert unit_factor("engine_rpm", "rev/min") == pytest.approx(1e-3)
    assert unit_factor("engine_rpm", "rad/s") * 2 * np.pi / 60 * 1000 == pytest.approx(1)
    assert unit_factor("throttle", "percent") == pytest.approx(0.01)
    assert unit_factor("position", "") == 1
    assert unit_factor("steer", "deg", 0.5) == pytest.approx(np.pi / 180 / 0.5)
    assert unit_factor("steer", "", 0.5) == unit_factor("steer", "1", 0.5) == 1
