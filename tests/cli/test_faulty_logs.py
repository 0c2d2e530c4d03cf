"""Faulty logs in `fit-pca` and `extract`: one line, and earlier drives stay; units of point times."""

import re
from pathlib import Path

import numpy as np
import pytest

from cli.command import refusal, run
from offpiste.core.conventions import FEATURE_SETS
from offpiste.dataset.store import open_dataset
from offpiste.inspection.draft_sensors import draft_sensors
from offpiste.logs import open_log
from offpiste.logs.ros.sensor_messages import message_from_points
from point_clocks import DRIVERS, SWEEP, PointClock
from sensor_bags import sensor_rig, stamp
from sensor_drive import AROUND, RIG, STATIC, clouds, good_drive, images, poses, written


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return good_drive(tmp_path_factory.mktemp("cli"))


@pytest.fixture(scope="module")
def pca(folder) -> Path:
    options = ["--backbone", "filterbank", "--images", "4", "--components", "3", "--split", "blocks:1,0,0"]
    assert run("fit-pca", folder / "good.mcap", "--rig", folder / "rig.toml", "--out", folder / "p.pca", *options) == 0
    return folder / "p.pca"


def extraction(folder: Path, pca: Path, out: Path, *logs: Path) -> tuple[object, ...]:
    """The command that extracts logs with the rig of a folder."""
    options = ("--rig", folder / "rig.toml", "--pca", pca, "--split", "blocks:1,0,0", "--processes", 1)
    return ("extract", *logs, "--out", out, "--force", *options)


NAN = np.full((50, 3), np.nan)
BAD = {
    "no calibration": (
        (STATIC[:1], images(), clouds(), poses()),
        r"'front': images without calibration: no topic '/info'; give cameras\.front\.intrinsics in the rig",
    ),
    "clouds of NaN": ((STATIC, images(), clouds(NAN), poses()), r"'top': 10 clouds have no usable point, one after"),
    "a clock of its own": (
        (STATIC, images(stamped=lambda t: t + 500), clouds(), poses()),
        r"'front' has no message from 100\.000 to 106\.000 s, where the pose is known; use clock\.stamps",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_extract_ends_in_one_line_and_keeps_what_was_there(case, capsys, folder, pca, tmp_path):
    parts, message = BAD[case]
    bad = written(tmp_path / "bad.mcap", *parts)
    said = refusal(capsys, *extraction(folder, pca, tmp_path / "d.zarr", folder / "good.mcap", bad))
    assert re.search(f"bad.mcap.*{message}", said), said
    assert [drive.name for drive in open_dataset(tmp_path / "d.zarr").drives] == ["good"]


@pytest.mark.parametrize("case", ["no calibration", "clouds of NaN"])
def test_fit_pca_ends_in_one_line_and_writes_nothing(case, capsys, folder, tmp_path):
    parts, message = BAD[case]
    bad, out = written(tmp_path / "bad.mcap", *parts), tmp_path / "p.pca"
    options = ("--backbone", "filterbank", "--images", 4, "--split", "blocks:1,0,0")
    said = refusal(capsys, "fit-pca", bad, "--rig", folder / "rig.toml", "--out", out, *options)
    assert re.search(message, said), said
    assert not out.exists()


NOTED = {
    "some NaN": (
        (STATIC, images(), [c for n, c in enumerate(clouds(NAN)) if n % 4 == 0], clouds(first=0.02), poses()),
        "top: 6 of 30 clouds have no usable point and were dropped",
    ),
    "jumps": ((STATIC, images(), clouds(), poses(lambda t: 3.0 * (t > 3))), "poses jump once, 3.00 s after they start"),
    "late": ((STATIC, images(first=2.0), clouds(), poses()), "front: starts 2.0 s after the poses"),
}


@pytest.mark.parametrize("case", NOTED)
def test_what_can_be_used_in_part_is_used_and_told(case, capsys, folder, pca, tmp_path):
    parts, note = NOTED[case]
    log = written(tmp_path / "some.mcap", *parts)
    assert run(*extraction(folder, pca, tmp_path / "d.zarr", log)) == 0
    assert note in capsys.readouterr().out
    (drive,) = open_dataset(tmp_path / "d.zarr").drives
    assert any(note in kept for kept in drive.notes)
    assert drive.rows.cells.valid[0].any()


def test_after_a_jump_no_cell_holds_what_was_seen_before(folder, pca, tmp_path):
    """At 2 m/s, cells reached within a second after the jump were 5 m away or more before it only."""
    log = written(tmp_path / "jump.mcap", STATIC, images(), clouds(), poses(lambda t: 3.0 * (t > 3)))
    run(*extraction(folder, pca, tmp_path / "d.zarr", folder / "good.mcap", log))
    drives = open_dataset(tmp_path / "d.zarr").drives
    assert drives[0].notes == ()
    good, jumped = (drive.rows for drive in drives)
    time, seen = good.time - good.time[0], []
    for rows in (good, jumped):
        cells = np.unique(rows.cells.index[(time > 3.3) & (time < 4.1)])
        cells = cells[cells >= 0]
        assert rows.cells.valid[0, cells].any()
        seen.append(rows.cells.valid[FEATURE_SETS.index("10"), cells].mean())
    assert seen[0] > 0.5
    assert seen[1] == 0
    assert not jumped.valid[np.abs(time - 3) < 0.1].any()
    assert jumped.valid.sum() > 100


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
def test_a_drafted_rig_reads_the_times_of_points(name, tmp_path):
    log = open_log(log_of(DRIVERS[name], tmp_path / "log.mcap"))
    (lidar,) = sensor_rig(draft_sensors(log, "/odom")).lidars.values()
    assert {key: getattr(lidar, key) for key in DRIVERS[name].entries} == DRIVERS[name].entries


@pytest.mark.parametrize(("name", "key"), [("Ouster", "time_unit"), ("Livox", "time_origin")])
def test_a_wrong_unit_or_origin_is_one_finding_and_stops_extract(name, key, tmp_path, capsys, pca):
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
