"""A log format of an extension: a EuRoC folder with poses and a camera."""

import re
import runpy
from pathlib import Path

import cv2
import numpy as np
import pytest

from extending.outside import EXTENSIONS, offpiste, succeeded
from factories import WITHOUT_COMMANDS
from offpiste.dataset.store import open_dataset
from offpiste.logs import open_log
from offpiste.logs.log import LOG_FORMATS
from offpiste.logs.sensor_log import open_sensors
from offpiste.rig.rig import parse_rig

START = 1_400_000_000_000_000_000
"""First stamp [ns]."""
SPEED = 2.0
RIG = f"""{WITHOUT_COMMANDS}
[channels.position]
topic = "state_groundtruth_estimate0"
fields = ["p_RS_R_x", "p_RS_R_y", "p_RS_R_z"]
[channels.orientation]
topic = "state_groundtruth_estimate0"
fields = ["q_RS_x", "q_RS_y", "q_RS_z", "q_RS_w"]
[frames]
body = "body"
[cameras.left]
topic = "cam0"
info = "cam0"
"""
CALIBRATION = """%YAML:1.0
T_BS:
  cols: 4
  rows: 4
  data: [0, 0, 1, 0.5,  -1, 0, 0, 0,  0, -1, 0, 1.5,  0, 0, 0, 1]
resolution: [64, 48]
distortion_model: radial-tangential
intrinsics: [40.0, 40.0, 31.5, 23.5]
distortion_coefficients: [-0.1, 0.01, 0.0, 0.0]
"""
IMAGE = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("euroc") / "MH_00_small"
    poses, camera = (folder / "mav0" / name for name in ("state_groundtruth_estimate0", "cam0"))
    for table in (poses, camera / "data"):
        table.mkdir(parents=True)
    names = [f"p_RS_R_{axis} [m]" for axis in "xyz"] + [f"q_RS_{axis} []" for axis in "wxyz"]
    rows = [f"{START + i * 20_000_000},{SPEED * i / 50},0,0.1,1,0,0,0" for i in range(301)]
    (poses / "data.csv").write_text("\n".join([f"#timestamp, {', '.join(names)}", *rows, ""]))
    stamps = [START + i * 250_000_000 for i in range(24)]
    (camera / "data.csv").write_text("#timestamp [ns],filename\n" + "".join(f"{t},{t}.png\n" for t in stamps))
    for number, stamp in enumerate(stamps):
        cv2.imwrite(str(camera / "data" / f"{stamp}.png"), np.roll(IMAGE, number, axis=0)[:, :, ::-1])
    (camera / "sensor.yaml").write_text(CALIBRATION)
    (folder.parent / "rig.toml").write_text(RIG)
    return folder


def test_inspect_recognises_the_folder_and_checks_its_camera(drive: Path) -> None:
    done = offpiste("inspect", drive, "--rig", drive.parent / "rig.toml", extension="euroc")
    assert re.search(r"cam0 +images +24", done.stdout), done.stdout + done.stderr
    assert re.search(r"state_groundtruth_estimate0 +table +301 +50.0", done.stdout)
    # EuRoC has no commands; images and poses are fine.
    assert "there is no control channel" in done.stdout
    assert "NOT usable for training" in done.stdout


def test_extract_reads_its_poses(drive: Path, tmp_path: Path) -> None:
    options = ("--rig", drive.parent / "rig.toml", "--out", tmp_path / "d.zarr", "--split", "blocks:1,0,0", "--force")
    succeeded("extract", drive, *options, extension="euroc")
    (extracted,) = open_dataset(tmp_path / "d.zarr").drives
    np.testing.assert_allclose(np.nanmedian(extracted.rows.state[:, 3]), SPEED, atol=0.01)


def test_its_camera_is_read_through_the_rig(drive: Path) -> None:
    before = set(LOG_FORMATS)
    runpy.run_path(str(EXTENSIONS / "euroc.py"))
    try:
        log = open_sensors(open_log(drive), parse_rig(RIG, where="rig.toml"))
        images = list(log.stream())
    finally:
        for name in set(LOG_FORMATS) - before:
            del LOG_FORMATS._entries[name]
    assert len(images) == 24
    assert np.array_equal(images[0].pixels, IMAGE)
    np.testing.assert_allclose(log.cameras["left"].body_from_camera[:3, 3], [0.5, 0.0, 1.5])
    assert log.cameras["left"].model.distortion == (-0.1, 0.01, 0.0, 0.0)


def test_without_the_extension_the_folder_is_not_recognised(drive: Path) -> None:
    done = offpiste("inspect", drive, extension="")
    assert done.returncode == 1
    assert done.stderr.startswith(f"offpiste: {drive}: no known log format; give a ROS bag (.bag, .mcap, .db3")
