"""Edits of rigs: values, refusals and text."""

import math
import tomllib
from collections.abc import Callable
from typing import Any

import pytest

from offpiste.core.errors import RigError
from offpiste.rig.edits import Edit, edited, edited_text, toml_value
from offpiste.rig.rig import load_rig, parse_rig, rig_text

RIG = load_rig("tartandrive2")


def test_an_edit_sets_one_entry_and_leaves_the_rest() -> None:
    assert str(Edit("channels.steer.sign", -1)) == "channels.steer.sign = -1"
    assert str(Edit("channels.yaw_rate", None)) == "remove channels.yaw_rate"
    changed = edited(RIG, [Edit("channels.steer.sign", 1), Edit("clock.max_gap", 0.25)])
    assert changed.channels["steer"].sign == 1
    assert changed.clock.max_gap == 0.25
    assert edited(changed, [Edit("channels.steer.sign", -1), Edit("clock.max_gap", RIG.clock.max_gap)]) == RIG


@pytest.mark.parametrize(
    "edit", [Edit("channels.steer.sign", 2), Edit("channels.steer.nonsense", 1), Edit("channels.position", None)]
)
def test_an_impossible_edit_is_refused(edit: Edit) -> None:
    with pytest.raises(RigError, match=f"^{RIG.name}: "):
        edited(RIG, [edit])


@pytest.mark.parametrize(
    "value",
    [
        -1,
        0.25,
        1.0,
        1e-9,
        "deg",
        ["x", "y"],
        [1.0, -2.5],
        {"above": 4000.0, "axes[0]": 6553.6},
        math.inf,
        {"a": -math.inf},
    ],
)
def test_values_are_written_as_toml_reads_them(value: object) -> None:
    assert tomllib.loads(f"key = {toml_value(value)}") == {"key": value}


WRAP = {"above": 4000.0, "period": 6553.6}
EDITS = [
    [Edit("channels.{channel}.sign", -1), Edit("channels.{channel}.delay", 0.25)],
    [Edit("channels.{channel}.wrap", WRAP), Edit("channels.{channel}.clip", [-1.0, 1.0])],
    [Edit("channels.{channel}.fields", None), Edit("channels.{channel}.fields", ["a"])],
    [Edit("channels.{channel}", None), Edit("absent", ["throttle", "brake", "steer", "brake_pressure", "steer_angle",
                                                      "steer_rate", "engine_rpm"])],
    [Edit("channels.wheel_speed", {"fields": ["w"], "unit": "km/h", "wrap": WRAP})],
    [Edit("channels.yaw_rate.topic", "imu"), Edit("channels.yaw_rate.fields", ["z"])],
    [Edit("clock.max_gap", 0.7), Edit("clock.stamps", "receive"), Edit("motion.window", 0.4)],
    [Edit("vehicle.max_steer", 0.31), Edit("vehicle.source", "measured"), Edit("vehicle.mass", 12.5)],
    [Edit("vehicle.wheel_positions", [[1.0, 0.5], [1.0, -0.5], [-1.0, 0.5], [-1.0, -0.5]])],
    [Edit("alignment", {"topics": ["a"], "speed": {"fields": ["2"], "scale": 0.04}}), Edit("alignment.speed.sign", -1)],
    [Edit("alignment", None), Edit("description", None), Edit("motion", None)],
    [Edit("lidars.extra", {"topic": "/points", "own_body": [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]})],
    [Edit("lidars.extra.topic", "/points"), Edit("lidars.extra.delay", 0.1), Edit("frames.body", "imu")],
]  # fmt: skip


def unless_refused(make: Callable[[], Any]) -> Any:
    """Return the result of a function, or None if it refuses the rig."""
    try:
        return make()
    except RigError:
        return None


@pytest.mark.parametrize("preset", ["dart", "proving_ground", "tartandrive2"])
@pytest.mark.parametrize("edits", EDITS, ids=lambda edits: str(edits[0]))
def test_edited_text_is_read_as_the_edited_rig(preset: str, edits: list[Edit]) -> None:
    text = rig_text(preset)
    rig = parse_rig(text, where=preset)
    channels = [name for name in ("steer", "throttle", "position") if name in rig.channels]
    for channel in channels if "{channel}" in edits[0].key else channels[:1]:
        named = [Edit(edit.key.format(channel=channel), edit.value) for edit in edits]
        changed = unless_refused(lambda named=named: edited_text(text, named))
        if not changed:
            assert unless_refused(lambda named=named: edited(rig, named)) is None
            continue
        assert parse_rig(changed, where=preset) == edited(rig, named)
        kept = [line for line in text.splitlines() if line.startswith("#")]
        assert [line for line in changed.splitlines() if line.startswith("#")] == kept


COMMENTED = """# of the buggy
name = "buggy"  # ours
absent = ["brake", "brake_pressure", "steer", "steer_angle", "steer_rate", "engine_rpm"]

[vehicle]
mass = 900.0  # with crew
pose_point = "axle"
wheel_positions = [[1.0, 0.5], [1.0, -0.5], [0.0, 0.5], [0.0, -0.5]]

# the pedals
[channels.throttle]
fields = ["t"]  # percent
scale = 2.0     # measured

[channels.position]
fields = ["x", "y"]

[channels.yaw]
fields = ["yaw"]

# the clock drifts
[clock]
max_gap = 1.0
"""


def test_edited_text_touches_nothing_else() -> None:
    edits = [
        Edit("channels.throttle.scale", 3.0), Edit("channels.throttle.sign", -1), Edit("channels.yaw.unit", "deg"),
        Edit("channels.yaw_rate", {"fields": ["w"]}), Edit("motion.window", 0.4), Edit("description", "a buggy"),
    ]  # fmt: skip
    wanted = COMMENTED.replace("scale = 2.0     # measured", "scale = 3.0     # measured\nsign = -1")
    wanted = wanted.replace('["yaw"]\n', '["yaw"]\nunit = "deg"\n\n[channels.yaw_rate]\nfields = ["w"]\n')
    wanted = wanted.replace('"engine_rpm"]\n', '"engine_rpm"]\ndescription = "a buggy"\n')
    assert edited_text(COMMENTED, edits) == f"{wanted}\n[motion]\nwindow = 0.4\n"


def test_text_that_is_no_rig_is_refused() -> None:
    with pytest.raises(RigError, match="not valid TOML"):
        edited_text("name = ", [Edit("name", "x")])
    with pytest.raises(RigError, match=r"channels\.position is missing"):
        edited_text(rig_text("dart"), [Edit("channels.position", None)])
