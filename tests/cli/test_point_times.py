"""Units of point times in `inspect`, drafted rigs and `extract`."""

from pathlib import Path

import numpy as np
import pytest

from cli.command import refusal, run
from cli.test_faulty_logs import extraction, folder, pca  # noqa: F401 - fixtures
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
    starts = 0.1 + SWEEP * np.arange(58)
    clouds = [message_from_points(clock.fill(stamp(at) / 1e9, AROUND), stamp(at), "lidar") for at in starts]
    scans = [(at + SWEEP, "/points", cloud) for at, cloud in zip(starts.tolist(), clouds, strict=True)]
    return written(path, STATIC, images(), scans, poses())


@pytest.mark.parametrize("name", DRIVERS)
def test_a_drafted_rig_reads_the_times_of_points(name: str, tmp_path: Path) -> None:
    log = open_log(log_of(DRIVERS[name], tmp_path / "log.mcap"))
    (lidar,) = sensor_rig(draft_sensors(log, "/odom")).lidars.values()
    assert {key: getattr(lidar, key) for key in DRIVERS[name].entries} == DRIVERS[name].entries


@pytest.mark.parametrize(("name", "key"), [("Ouster", "time_unit"), ("Livox", "time_origin")])
def test_a_wrong_unit_or_origin_is_one_finding_and_stops_extract(name, key, tmp_path, capsys, pca):  # noqa: F811
    clock, rig, log = DRIVERS[name], tmp_path / "rig.toml", log_of(DRIVERS[name], tmp_path / "log.mcap")
    right = clock.entries[key]
    extract, edit = extraction(tmp_path, pca, tmp_path / "d.zarr", log), f'lidars.top.{key} = "{right}"'
    rig.write_text(RIG + clock.rig_lines(**{key: WRONG[key][right]}))
    run("inspect", log, "--rig", rig)
    assert capsys.readouterr().out.count(edit) == 1
    line = refusal(capsys, *extract)
    assert line.endswith(edit)
    assert f"'top': '{clock.field}', read in " in line
    rig.write_text(RIG + clock.rig_lines())
    assert run(*extract) == 0
    capsys.readouterr()
    run("inspect", log, "--rig", rig)
    said = capsys.readouterr().out
    assert not any(entry in said for entry in WRONG)
