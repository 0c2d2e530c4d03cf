"""Faults of sensors change what is read as much as their strength says; their scores by hand; a run that resumes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import experiments.inspection_faults.sensors as scoring
from experiments.inspection_faults.sensor_faults import CAMERA, LIDAR, SENSOR_FAULTS, mounting_key
from experiments.inspection_faults.sensors import SensorFaults, report, score
from made_up_sensors import GROUND, TIMES, body_points, sensor_case
from offpiste.calibration.misfit import turned
from offpiste.inspection.findings import Finding
from offpiste.rig.edits import Edit

CASE = sensor_case()
TURNED = "looks 2.0 degrees away from its stated mounting"


def given(name, strength, seed=1):
    return SENSOR_FAULTS[name].change(CASE, strength, np.random.default_rng(seed))


def read(case):
    """All that a fault may change."""
    shown = [int(image.pixels[0, 0, 0]) for image in case.log.images("/camera_front/image/compressed", times=TIMES)]
    height = case.log.read("/odometry", ["pose.pose.position.z"]).values
    return case.rig, body_points(case).round(4).tolist(), shown, height.tolist()


@pytest.mark.parametrize("name", SENSOR_FAULTS)
def test_each_changes_something_and_the_same_seed_gives_the_same(name):
    for strength in SENSOR_FAULTS[name].strengths:
        faulty = read(given(name, strength))
        assert faulty != read(CASE)
        assert faulty == read(given(name, strength))


def test_a_post_stands_outside_the_box_of_the_own_body():
    fault, faulty = SENSOR_FAULTS["post in view"], given("post in view", 0.15)
    for time in TIMES[:3]:
        points = body_points(faulty, time)
        post = points[:, 2] > GROUND + 0.2
        assert post.sum() > 20
        assert np.linalg.norm(points[post, :2] - faulty.part[:2], axis=1).max() < 0.15
    assert not fault.fixed(faulty, faulty.rig)
    assert fault.fixed(faulty, faulty.with_rig((f"lidars.{LIDAR}.own_body", [[-3, -3, -1], [3, 3, 4]])).rig)


@pytest.fixture
def scored(monkeypatch):
    """Score a fault about which a check says this."""

    def score_of(name, findings, strength=2.0):
        monkeypatch.setattr(scoring, "check_sensors", lambda log, rig: list(findings))
        return score(6, CASE, SENSOR_FAULTS.get(name), strength)

    return score_of


def finding(where, what, *fixes):
    return Finding("warning", where, what, "1 of 1", "fix it", cures=tuple((fix,) for fix in fixes))


def mounting(degrees):
    """The edit that mounts the camera so far from the truth."""
    matrix = turned(CASE.layout.mounting(CAMERA), np.array([0, 0, np.deg2rad(degrees), 0]))
    orientation = Rotation.from_matrix(matrix[:3, :3]).as_quat().tolist()
    return Edit(mounting_key(CAMERA), {"position": matrix[:3, 3].tolist(), "orientation": orientation})


@pytest.mark.parametrize(
    ("fixes", "wanted"),
    [
        ([mounting(0.3)], "right"),
        ([mounting(0.7)], "wrong"),
        ([Edit(f"cameras.{CAMERA}.delay", 0.1)], "wrong"),
        ([Edit(f"cameras.{CAMERA}.delay", "soon")], "wrong"),  # no rig
        ([], "none"),
    ],
)
def test_a_fix_is_right_if_it_brings_the_truth_back(scored, fixes, wanted):
    result = scored("camera turned", [finding(CAMERA, TURNED, *fixes)])
    assert (result.found, result.fix, result.alarms) == (True, wanted, ())


def test_findings_elsewhere_are_alarms_and_consequences_are_not(scored):
    result = scored("LiDAR turned", [finding(CAMERA, TURNED), finding("poses", "drift in height")])
    assert (result.found, result.noted, result.fix, len(result.alarms)) == (False, False, "", 1)
    assert "camera_front" in result.alarms[0]


def test_the_table_counts_by_strength(scored):
    found = scored("camera turned", [finding(CAMERA, TURNED, mounting(0.1))])
    missed = scored("camera turned", [], strength=0.5)
    text = report([found, missed, scored("", [finding(LIDAR, TURNED)])])
    assert "| camera turned | 2 deg | 1/1 | 0 | 1/1 |" in text
    assert "| camera turned | 0.5 deg | 0/1 | 0 | 0/0 |" in text
    assert "healthy logs with a false alarm | 1/1" in text
    assert "faults found or noted | 1/2 = 50%" in text


def test_a_run_resumes(monkeypatch, tmp_path):
    asked = []
    monkeypatch.setattr(SensorFaults, "case", lambda self, seed: asked.append(seed) or CASE)
    monkeypatch.setattr(scoring, "check_sensors", lambda log, rig: [])
    SensorFaults(out=tmp_path, seed=1, logs=2).run()
    assert "1 healthy logs" not in SensorFaults(out=tmp_path, seed=1, logs=3).run()
    assert asked == [1, 2, 3]
    assert (tmp_path / "report.md").exists()
