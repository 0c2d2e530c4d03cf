"""Poses: samples that no vehicle makes, noise, units, and axes that point down."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig

from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.findings import TIPPED, Finding
from offpiste.inspection.inspect import Inspection, inspect_log
from offpiste.inspection.pose import check_position_unit
from offpiste.inspection.pose_samples import check_level
from offpiste.logs.channel import Channel
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig

CLEAN = drive_log(seconds=60)
PLACE_ONLY = edited(rig(), [Edit("channels.linear_velocity", None), Edit("channels.angular_velocity", None)])


def _inspected(log: MemoryLog, now: Rig | None = None) -> tuple[Inspection, list[Finding]]:
    found = inspect_log(log, now or rig())
    return found, [f for f in found.findings if f.severity != "note"]


def test_a_corrupt_run_is_named_by_its_samples_and_spoils_no_summary() -> None:
    def corrupt(x: np.ndarray) -> np.ndarray:
        x[1000:1086] = 1e10 * np.random.default_rng(0).uniform(0.9, 1.1, 86)
        return x

    found, complaints = _inspected(CLEAN.change("odom", "x", corrupt))
    assert any("first 1000, the last 1085" in f.evidence for f in complaints if f.where.startswith("position"))
    assert found.summary.speed_max < 20


def test_a_tail_that_is_faster_than_any_vehicle_is_left_out() -> None:
    def fast(x: np.ndarray) -> np.ndarray:
        x[2900:] += 571.0 * 0.02 * np.arange(len(x) - 2900)
        return x

    found, complaints = _inspected(CLEAN.change("odom", "x", fast))
    assert [f.what for f in complaints if f.where == "position"] == ["has samples that no vehicle makes"]
    assert found.summary.speed_max < 20


def test_a_heading_that_jumps_is_reported_and_accuses_nothing_else() -> None:
    def jump(log: MemoryLog) -> MemoryLog:
        _, odom = log.data["odom"]
        yaw = 2 * np.arctan2(odom["qz"], odom["qw"])
        yaw[1500:1502] += 0.5
        return log.change("odom", "qz", lambda _: np.sin(yaw / 2)).change("odom", "qw", lambda _: np.cos(yaw / 2))

    _, complaints = _inspected(jump(CLEAN))
    assert {f.where for f in complaints} == {"orientation"}


@pytest.mark.parametrize("now", [rig(), PLACE_ONLY], ids=["with velocities", "places only"])
def test_noise_that_spoils_starts_or_velocities_is_reported(now: Rig) -> None:
    random = np.random.default_rng(0)
    log = CLEAN.change("odom", "x", lambda x: x + 0.5 * random.standard_normal(len(x)))
    log = log.change("odom", "y", lambda y: y + 0.5 * random.standard_normal(len(y)))
    _, complaints = _inspected(log, now)
    assert any(f.where == "position" and "nois" in f.what for f in complaints), complaints
    assert _inspected(CLEAN, now)[1] == []


def test_feet_are_found_by_what_else_knows_the_speed() -> None:
    log = CLEAN
    for field in "xyz":
        log = log.change("odom", field, lambda v: v / 0.3048)
    found, _ = _inspected(log)
    assert Edit("channels.position.unit", "ft") in found.cure


@pytest.mark.parametrize(
    ("axes", "fields"), [("body down", ("qx", "qy", "qz", "qw")), ("world down", ("qx", "qy", "qz", "qw"))]
)
def test_a_body_that_points_down_is_turned_up(axes: str, fields: tuple[str, ...]) -> None:
    from offpiste.logs.channel import to_z_up
    from offpiste.rig.channels import ChannelSource

    # Half a turn is its own inverse.
    source = ChannelSource(fields=fields)
    log = CLEAN
    _, odom = log.data["odom"]
    turned = to_z_up("orientation", source, np.stack([odom[f] for f in fields], axis=1), axes)
    for field, values in zip(fields, turned.T, strict=True):
        log = log.change("odom", field, lambda _, values=values: values)
    down = ("y", "z") if axes == "world down" else ("vy", "vz", "wy", "wz")
    for field in down:
        log = log.change("odom", field, np.negative)
    found, _ = _inspected(log)
    assert found.cure == (Edit("motion.axes", axes),)


@pytest.mark.parametrize("way", [0.0, np.pi / 2, np.pi])
def test_a_jump_counts_in_any_direction(way: float) -> None:
    """One to the side or backwards, too, where the step is hardly longer than those beside it."""
    zero = np.zeros(3000)
    odom = dict.fromkeys(("y", "z", "qx", "qy", "qz", "vy", "vz", "wx", "wy", "wz"), zero)
    odom |= {"x": 0.3 * np.arange(3000.0), "qw": zero + 1, "vx": zero + 15.0}
    log = MemoryLog({**CLEAN.data, "odom": (CLEAN.data["odom"][0], odom)})
    for field, by in (("x", np.cos(way)), ("y", np.sin(way))):
        log = log.change("odom", field, lambda x, by=by: x + 1.5 * by * (np.arange(3000) >= 1500))
    (finding,) = (f for f in inspect_log(log, rig()).findings if (f.where, f.what) == ("position", "jumps"))
    assert finding.evidence.startswith("1 times, by up to 1.50 m")


@pytest.mark.parametrize("speed", [30.0, 60.0])
def test_positions_that_run_away_change_their_velocity_in_an_instant(speed: float) -> None:
    def run_away(x: np.ndarray) -> np.ndarray:
        x[2400:] += speed * 0.02 * np.arange(len(x) - 2400)
        return x

    _, complaints = _inspected(CLEAN.change("odom", "x", run_away))
    (finding,) = (f for f in complaints if f.what == "changes its velocity in an instant")
    assert float(finding.evidence.split()[1]) == pytest.approx(48.0, abs=0.6)
    assert {f.what for f in complaints if f.severity != "note"} == {finding.what}  # what follows from it is not said


def test_a_jump_of_height_is_said_as_one() -> None:
    time, _ = CLEAN.data["odom"]
    log = CLEAN.change("odom", "z", lambda z: z + 2.0 * (time > time[len(time) // 2]))
    (finding,) = (f for f in inspect_log(log, rig()).findings if f.where == "position")
    assert (finding.severity, finding.what) == ("warning", "jumps")
    assert float(finding.evidence.split("up to ")[1].split()[0]) == pytest.approx(2.0, abs=0.05)
    assert "m of height" in finding.evidence


def test_a_position_that_jumps_goes_on_as_before() -> None:
    _, complaints = _inspected(CLEAN.change("odom", "x", lambda x: np.where(np.arange(len(x)) < 2400, x, x + 15)))
    assert "changes its velocity in an instant" not in [f.what for f in complaints]


@pytest.mark.parametrize("longitude", [8.5, 151.2, -151.2, 208.8])
def test_degrees_reach_around_the_earth_and_heights_are_metres(longitude: float) -> None:
    """A degree is some 111 km, so what is far for one is near for the other."""
    log = CLEAN.change("odom", "x", lambda east: east / 84_880 + longitude)
    log = log.change("odom", "y", lambda north: north / 111_040 + 47.4).change("odom", "z", lambda up: up + 2450)
    swiss = edited(
        rig(), [Edit("channels.position.unit", "lat lon"), Edit("channels.position.fields", ["y", "x", "z"])]
    )
    assert [f for f in inspect_log(log, swiss).findings if "beyond" in f.what] == []
    nowhere = log.change("odom", "y", lambda north: np.where(np.arange(len(north)) == 700, 95.0, north))
    (finding,) = (f for f in inspect_log(nowhere, swiss).findings if "beyond" in f.what)
    assert finding.where == "position (odom y)"
    assert finding.evidence.startswith("1 of ")


def test_degrees_that_are_counted_get_their_scale_and_lose_a_height_in_another() -> None:
    """As PX4 and u-blox receivers record them: integers of 1e-7 degrees, and millimetres of height."""
    log = CLEAN.change("odom", "x", lambda east: np.round(1e7 * (east / 75_488 + 8.5)))
    log = log.change("odom", "y", lambda north: np.round(1e7 * (north / 111_180 + 47.4)))
    log = log.change("odom", "z", lambda up: np.round(1000 * (up + 450)))
    counted = edited(
        rig(), [Edit("channels.position.unit", "lat lon"), Edit("channels.position.fields", ["y", "x", "z"])]
    )
    found = inspect_log(log, counted)
    fatal = [f for f in found.findings if f.severity == "fatal"]
    assert {f.what for f in fatal} == {"is counted in ten-millionths of a degree"}
    assert found.cure == (Edit("channels.position.scale", 1e-7), Edit("channels.position.fields", ["y", "x"]))
    cured = edited(counted, found.cure)
    assert not [f for f in inspect_log(log, cured).findings if f.severity != "note"]
    driven = np.hypot(*np.ptp(drive_from_log(CLEAN, rig()).channels["position"].values[:, :2], axis=0))
    assert np.hypot(*np.ptp(drive_from_log(log, cured).channels["position"].values, axis=0)) == pytest.approx(
        driven, 0.01
    )


@pytest.mark.parametrize(("lacks", "fields"), [("odom", ["y", "x"]), ("", ["y", "x", "height"])])
def test_places_in_degrees_that_the_log_lacks_are_missing_and_no_more(lacks: str, fields: list[str]) -> None:
    log = MemoryLog({topic: data for topic, data in CLEAN.data.items() if topic != lacks})
    degrees = edited(rig(), [Edit("channels.position.unit", "lat lon"), Edit("channels.position.fields", fields)])
    found = inspect_log(log, degrees).findings
    assert any(f.where == "position" and ("is not in the log" in f.what or "no field" in f.what) for f in found)


@pytest.mark.parametrize(("unit", "metre"), [("mm", 1000.0), ("cm", 100.0)])
def test_a_small_vehicle_in_millimetres_is_no_fast_one_in_centimetres(unit: str, metre: float) -> None:
    log = drive_log(seconds=60)
    for field in ("x", "y", "z"):
        log = log.change("odom", field, lambda values: 0.3 * metre * values)
    drive = drive_from_log(log, rig())
    (finding,) = check_position_unit(drive, driven_path(drive))
    assert finding.cures[0] == (Edit("channels.position.unit", unit),)


def test_a_heading_that_is_lost_with_the_place_is_said_of_the_place() -> None:
    odom, lost = CLEAN.data["odom"][1], np.abs(np.arange(len(CLEAN.data["odom"][0])) - 2537) < 38
    half = np.arctan2(odom["qz"], odom["qw"]) + np.where(lost, 1.0, 0.0)
    turned = CLEAN.change("odom", "qz", lambda x: np.sin(half)).change("odom", "qw", lambda x: np.cos(half))
    assert [f.where for f in _inspected(turned)[1]] == ["orientation"]
    both = turned.change("odom", "x", lambda x: np.where(lost, 0.0, x))
    assert [f.where for f in _inspected(both)[1]] == ["position"]


@pytest.mark.parametrize("heading", [False, True])
def test_a_place_that_hangs_while_the_vehicle_drives_on_is_found(heading: bool) -> None:
    log = drive_log(seed=3)
    time, odom = log.data["odom"]
    speed = np.hypot(np.gradient(odom["x"], time), np.gradient(odom["y"], time))
    first = int(np.argmax((speed > 3.0) & (time > time[0] + 20.0)))
    end = int(np.searchsorted(time, time[first] + 8.0))
    for field in ("x", "y", "z", *(("qx", "qy", "qz", "qw") if heading else ())):
        log = log.change("odom", field, lambda values: np.concatenate(
            (values[:first], np.full(end - first, values[first]), values[end:])))  # fmt: skip
    found = {(finding.where, finding.what): finding for finding in inspect_log(log, rig()).findings}
    finding = found["position", "holds one place while the vehicle drives on"]
    assert f"for 8.0 s from {time[first + 1] - time[0]:.2f} s on" in finding.evidence
    assert ("position", "jumps") not in found


def _span(x: float, y: float, z: float, seed: int = 0) -> list[Finding]:
    """What a loop of these sizes along the axes, which scatters by some centimetres, says of the axis that is up."""
    angle, rng = np.linspace(0, 6 * np.pi, 3000), np.random.default_rng(seed)
    place = np.stack((x * np.cos(angle), y * np.sin(0.3 * angle), z * np.sin(angle)), axis=1) / 2
    place += rng.normal(0, 0.05, place.shape)
    given = rig(('fields = ["x", "y", "z"]', 'fields = ["px", "py", "pz"]'))
    return check_level(Channel("position", "m", np.arange(3000) / 50, place), given, ())


@pytest.mark.parametrize(("x", "y", "z"), [(400.0, 3.0, 180.0), (180.0, 3.0, 400.0), (50.0, 0.0, 50.0)])
def test_y_is_up_where_the_path_is_level_only_along_it(x: float, y: float, z: float) -> None:
    """Also where it goes further along x than along z."""
    (finding,) = _span(x, y, z)
    assert finding.severity == "fatal"
    ways = [{edit.key: edit.value for edit in cure}["channels.position.fields"] for cure in finding.cures]
    assert [sorted(way) for way in ways] == 2 * [["px", "py", "pz"]]
    assert all(way[2] == "py" for way in ways)


def test_a_straight_road_over_hills_and_a_height_that_scatters_are_level() -> None:
    time, rng = np.arange(3000) / 50, np.random.default_rng(1)
    along = 8 * time
    for hills, scatter in ((15.0, 0.05), (0.0, 1.5)):
        z = hills * np.sin(along / 60) + rng.normal(0, scatter, len(time))
        road = np.stack((along, 0.5 * np.sin(along / 100), z), axis=1)
        assert check_level(Channel("position", "m", time, road), rig(), ()) == []
        assert check_level(Channel("position", "m", time, road[:, [1, 0, 2]]), rig(), ()) == []


def test_places_beyond_the_moon_take_no_more_memory_than_others() -> None:
    rng = np.random.default_rng(0)
    far = np.stack((1e12 * rng.random(3000), rng.random(3000), 1e12 * rng.random(3000)), axis=1)
    (finding,) = check_level(Channel("position", "m", np.arange(3000) / 50, far), rig(), ())
    assert finding.what == TIPPED


def test_what_goes_with_positions_whose_y_is_up_goes_with_the_cure() -> None:
    log = drive_log(seed=1)
    time, odom = log.data["odom"]
    rows = {"p.x": odom["y"], "p.y": 0.1 * odom["z"], "p.z": odom["x"], "e.z": 0.3 * np.sin(time)}
    rows |= {"e.y": np.degrees(2 * np.arctan2(odom["qz"], odom["qw"]))}
    log = MemoryLog(log.data | {"unity": (time, rows)})
    position = ('topic = "odom"\nfields = ["x", "y", "z"]', 'topic = "unity"\nfields = ["p.x", "p.y", "p.z"]')
    old = '[channels.orientation]\ntopic = "odom"\nfields = ["qx", "qy", "qz", "qw"]'
    given = rig(position, (old, '[channels.yaw]\ntopic = "unity"\nfields = ["e.z"]\nunit = "deg"'))
    finding = next(f for f in inspect_log(log, given).findings if f.what == TIPPED)
    cured = edited(given, finding.cures[0])
    assert cured.channels["position"].fields == ("p.z", "p.x", "p.y")
    assert cured.channels["yaw"].fields == ("e.y",)
    (finding,) = (f for f in inspect_log(log, cured).findings if f.where in ("position", "yaw"))
    assert (finding.severity, finding.what, finding.cures) == ("note", "left and right may be exchanged", ())
    assert 'left-handed, as of games, channels.position.fields = ["p.x", "p.z", "p.y"]' in finding.remedy
