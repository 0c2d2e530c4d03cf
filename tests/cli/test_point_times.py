"""Units of point times in `inspect`, drafted rigs and `extract`."""

from pathlib import Path

import pytest

from cli.test_faulty_logs import extract, folder, pca, said_by  # noqa: F401 - fixtures
from offpiste.inspection.draft_sensors import draft_sensors
from offpiste.logs import open_log
from offpiste.logs.ros.sensor_messages import message_from_points
from point_clocks import DRIVERS, SWEEP, PointClock
from sensor_bags import sensor_rig, stamp
from sensor_drive import AROUND, RIG, STATIC, images, poses, written

WRONG = {
    "time_unit": {"ns": "us", "us": "ms", "ms": "s", "s": "ms"},
    "time_origin": {"stamp": "epoch", "epoch": "stamp"},
}


def log_of(clock: PointClock, path: Path) -> Path:
    """A drive of six seconds with ten scans a second."""
    scans = []
    for number in range(58):
        at = 0.1 + SWEEP * number
        message = message_from_points(clock.fill(stamp(at) / 1e9, AROUND), stamp(at), "lidar")
        scans.append((at + SWEEP, "/points", message))
    return written(path, STATIC, images(), scans, poses())


def rig_of(clock: PointClock, path: Path, **changed: str) -> Path:
    path.write_text(RIG + clock.rig_lines(**changed))
    return path


@pytest.mark.parametrize("name", DRIVERS)
def test_a_drafted_rig_reads_the_times_of_points(name: str, tmp_path: Path) -> None:
    log = open_log(log_of(DRIVERS[name], tmp_path / "log.mcap"))
    (lidar,) = sensor_rig(draft_sensors(log, "/odom")).lidars.values()
    assert {key: getattr(lidar, key) for key in DRIVERS[name].entries} == DRIVERS[name].entries


@pytest.mark.parametrize(("name", "key"), [("Ouster", "time_unit"), ("Livox", "time_origin")])
def test_a_wrong_unit_or_origin_is_one_finding_and_stops_extract(
    name: str,
    key: str,
    tmp_path: Path,
    capsys,
    pca: Path,  # noqa: F811
) -> None:
    clock = DRIVERS[name]
    right = clock.entries[key]
    log = log_of(clock, tmp_path / "log.mcap")
    rig = rig_of(clock, tmp_path / "rig.toml", **{key: WRONG[key][right]})
    edit = f'lidars.top.{key} = "{right}"'
    _, out, _ = said_by(capsys, "inspect", log, "--rig", rig)
    assert out.count(edit) == 1
    code, _, said = extract(capsys, tmp_path, pca, tmp_path / "d.zarr", log)
    assert code == 1
    (line,) = said.strip().splitlines()
    assert line.endswith(edit)
    assert f"'top': '{clock.field}', read in " in line
    rig_of(clock, tmp_path / "rig.toml")
    assert extract(capsys, tmp_path, pca, tmp_path / "d.zarr", log)[0] == 0
    _, out, _ = said_by(capsys, "inspect", log, "--rig", rig)
    assert "time_unit" not in out
    assert "time_origin" not in out
