"""Errors in [outputs] and [live] in one line."""

import pytest

from factories import RIG
from offpiste.core.errors import RigError
from offpiste.rig.outputs import Timeouts
from offpiste.rig.rig import load_rig, parse_rig
from offpiste.runtime.settings import RuntimeSettings

OUTPUT = """
[outputs.a]
topic = "/a"
type = "geometry_msgs/msg/Twist"
[outputs.a.fields]
"linear.x" = { of = "speed" }
"""
WRONG = {
    "no topic": (OUTPUT.replace('"/a"', '"a b"'), r"outputs\.a\.topic: 'a b' is not a topic"),
    "no type": (OUTPUT.replace("/msg/", "/"), r"outputs\.a\.type: 'geometry_msgs/Twist' is not a message type"),
    "no quantity": (
        OUTPUT.replace('"speed"', '"sped"'),
        r'outputs\.a\.fields\."linear\.x" holds \'sped\'.*give one of throttle, brake, steer',
    ),
    "no field": (OUTPUT.split('"linear')[0], r"outputs\.a\.fields is empty"),
    "no path": (OUTPUT.replace("linear.x", "linear x"), r"is not a field path"),
    "scale of zero": (OUTPUT.replace('"speed" }', '"speed", scale = 0 }'), r"no scale of zero"),
    "unit of another": (OUTPUT.replace('"speed" }', '"speed", unit = "rad" }'), r"'rad' does not measure"),
    "a steering that turns": (
        OUTPUT.replace('"speed" }', '"steer", unit = "rad/s" }'),
        r"'rad/s' is a unit of turn rates.*yaw_rate",
    ),
    "far ahead": (OUTPUT.replace('"speed" }', '"speed", ahead = 9 }'), r"ahead is 9"),
    "clip": (OUTPUT.replace('"speed" }', '"speed", clip = [1, 0] }'), r"clip is not an interval"),
    "one topic twice": (OUTPUT + OUTPUT.replace("outputs.a", "outputs.b"), r"two outputs have one topic"),
    "enable without a topic": ('[live.enable]\ntopic = ""\n', r"live\.enable\.topic"),
    "enable without time": ('[live.enable]\ntopic = "/e"\ntimeout = 0\n', r"live\.enable: invalid field or timeout"),
    "limit of zero": ("[live.limits]\nsteer_rate = 0\n", r"live\.limits\.steer_rate is 0"),
    "limit above one": ("[live.limits]\nthrottle = 2\n", r"live\.limits\.throttle is 2.*at most 1"),
    "limit of nan": ("[live.limits]\nspeed = nan\n", r"live\.limits\.speed is nan"),
    "limit of nothing": (OUTPUT + "[live.limits]\nthrottle = 0.5\n", r"live\.limits\.throttle has no effect"),
    "no such timeout": ("[live.timeouts]\nscans = 1\n", r"unknown timeout live\.timeouts\.scans.*scan_limit"),
    "timeout of zero": ("[live.timeouts]\nstate = 0\n", r"live\.timeouts\.state is 0.*give 0\.04 to 1"),
    "timeout of nan": ("[live.timeouts]\nplan = nan\n", r"live\.timeouts\.plan is nan"),
    "timeout shorter than plans": ("[live.timeouts]\nplan = 0.08\n", r"live\.timeouts\.plan is 0\.08.*0\.2 to 1"),
    "late after missing": ("[live.timeouts]\nscan = 2\n", r"live\.timeouts\.scan is above scan_limit"),
    "type of a topic": ('[live.types]\n"/odom" = "Odometry"\n', r"'Odometry' is not a message type"),
    "unknown key": ("[live]\nfast = true\n", r"fast"),
}


@pytest.mark.parametrize("case", WRONG)
def test_mistakes_are_named(case):
    text, what = WRONG[case]
    with pytest.raises(RigError, match=what):
        parse_rig(RIG + text, where="test")


def test_timeouts_are_those_of_the_run_time_but_for_what_is_given():
    given = parse_rig(RIG + "[live.timeouts]\nstate = 0.25\n", where="test").live.timeouts
    assert given == Timeouts(state=0.25)
    assert parse_rig(RIG, where="test").live.timeouts == RuntimeSettings().timeouts


def test_definitions_lie_beside_the_rig(tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text(RIG + '[live]\ndefinitions = ["my_msgs/msg/Drive.msg"]\n' + OUTPUT)
    assert load_rig(file).live.definitions == (str(tmp_path / "my_msgs/msg/Drive.msg"),)
    assert load_rig("proving_ground").outputs["command"].fields["axes[2]"].of == "steer"
