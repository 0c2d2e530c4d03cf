"""What is known of the recorded logs (their README) is found in them, and little else."""

from pathlib import Path

import msgspec
import pytest

from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.inspect import Inspection, inspect_log
from offpiste.logs import open_log
from offpiste.rig.rig import Rig, load_rig, parse_rig


@pytest.fixture(scope="module")
def turnpike(data_folder: Path) -> Path:
    return next((data_folder / "tartandrive2" / "drives").glob("*turnpike*"))


@pytest.fixture(scope="module")
def meadows(data_folder: Path) -> Path:
    return next((data_folder / "tartandrive2" / "drives").glob("*meadows*"))


@pytest.fixture(scope="module")
def unknown(turnpike: Path) -> Inspection:
    return inspect_log(open_log(turnpike))


def remedies(found: Inspection) -> list[str]:
    return [f.remedy for f in found.findings]


def change(rig: Rig, name: str, **values: object) -> Rig:
    source = msgspec.structs.replace(rig.channels[name], **values)
    return msgspec.structs.replace(rig, channels={**rig.channels, name: source})


def test_turnpike_without_a_rig(unknown: Inspection) -> None:
    assert unknown.usable
    assert unknown.summary.duration == pytest.approx(504, abs=1)
    assert unknown.summary.distance == pytest.approx(3750, rel=0.03)
    assert unknown.summary.speed_max == pytest.approx(14.6, abs=0.5)
    assert "channels.steer.sign = -1" in remedies(unknown)
    findings = {f.where: f for f in unknown.findings}
    assert findings["wheel_rpm[0]"].what == "isolated spikes"
    assert all(dead in findings["fields"].evidence for dead in ("cmd[0]", "shock_pos[0]", "shock_pos[1]"))


def test_the_vehicle_bus_has_a_clock_that_drifts(unknown: Inspection) -> None:
    (finding,) = (f for f in unknown.findings if f.what == "has a clock that drifts")
    assert finding.where == "controls, shock_pos, wheel_rpm"
    assert 'topic = "wheel_rpm"' in finding.remedy


def test_frames_of_velocities(turnpike: Path, meadows: Path) -> None:
    assert parse_rig(draft_rig(open_log(turnpike)), where="").channels["linear_velocity"].frame == "world"
    superb = parse_rig(draft_rig(open_log(meadows)), where="")
    assert superb.channels["linear_velocity"].topic == "super_odom"
    assert superb.channels["linear_velocity"].frame == "body"


@pytest.mark.parametrize("drive", ["turnpike", "meadows"])
def test_the_preset_leaves_little_to_say(drive: str, request: pytest.FixtureRequest) -> None:
    found = inspect_log(open_log(request.getfixturevalue(drive)), load_rig("tartandrive2"))
    assert found.usable
    assert [f for f in found.findings if f.severity == "warning"] == []


@pytest.mark.parametrize(
    ("name", "wrong", "remedy"),
    [
        ("steer", {"sign": 1}, "channels.steer.sign = -1"),
        ("steer", {"delay": -0.6}, "channels.steer.delay = "),
        ("linear_velocity", {"frame": "body"}, 'channels.linear_velocity.frame = "world"'),
        ("throttle", {"wrap": None}, "channels.throttle.wrap = "),
        ("orientation", {"fields": ("6", "3", "4", "5")}, 'channels.orientation.fields = ["3", "4", "5", "6"]'),
    ],
)
def test_a_wrong_preset_gets_the_right_line(turnpike: Path, name: str, wrong: dict[str, object], remedy: str) -> None:
    rig = change(load_rig("tartandrive2"), name, **wrong)
    found = inspect_log(open_log(turnpike), rig)
    assert any(m.startswith(remedy) for m in remedies(found)), remedies(found)


def test_bags_without_controls_or_pose_are_not_usable(data_folder: Path) -> None:
    findings = {
        path.name: [f.what for f in inspect_log(open_log(path)).findings if f.severity == "fatal"]
        for path in (data_folder / "bags").iterdir()
    }
    assert findings == {
        "evo_nav2_turtlebot.mcap": ["there is no control channel"],
        "PlotJuggler_tilt_laser.bag": ["there is no control channel"],  # a receiver and an IMU, at rest
        "rosbag2_only_topics.mcap": ["no topic looks like a pose (position and heading)"],
    }


def test_dart_raises_no_false_alarm(data_folder: Path) -> None:
    paths = sorted((data_folder / "dart").glob("*/*.csv"))[::2]
    assert len(paths) > 3
    for path in paths:
        preset = load_rig("dart_filtered" if "slippery" in path.parent.name else "dart")
        for rig in (None, preset):
            found = inspect_log(open_log(path), rig)
            assert found.usable
            assert [f for f in found.findings if f.severity == "warning"] == [], path
