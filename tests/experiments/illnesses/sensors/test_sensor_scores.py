"""Scores of sensors by hand: found, noted, cured, other alarms; the table; a run that resumes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import experiments.illnesses.sensors.score as scoring
import experiments.illnesses.sensors.trial as trial
from experiments.illnesses.sensors.case import mounting_key, true_mounting
from experiments.illnesses.sensors.declarations import SENSOR_ILLNESSES
from experiments.illnesses.sensors.drives import CAMERA, LIDAR, SensorDrive
from experiments.illnesses.sensors.score import SensorPatient, score
from experiments.illnesses.sensors.table import report
from experiments.illnesses.sensors.trial import SensorIllnesses
from made_up_sensors import sensor_case
from offpiste.inspection.findings import Finding
from offpiste.inspection.misfit import turned
from offpiste.rig.edits import Edit

CASE = sensor_case()
DRIVE = SensorDrive(1, CASE.log.path, "ordinary", "mast")


def scored(monkeypatch, name, findings, strength=2.0):
    """Score of an illness of which a check says this."""
    monkeypatch.setattr(scoring, "check_sensors", lambda log, rig: list(findings))
    ill = SENSOR_ILLNESSES[name] if name else None
    sick = ill.change(CASE, strength, np.random.default_rng(0)) if ill else CASE
    return score(SensorPatient(6, DRIVE, sick, ill, strength if ill else 0.0))


def finding(where, what, *cures, severity="warning"):
    return Finding(severity, where, what, "1 of 1", "see a doctor", cures=tuple((cure,) for cure in cures))


def mounting(degrees):
    """The edit that mounts the camera so far from the truth."""
    matrix = turned(true_mounting(CASE.layout, CAMERA), np.array([0, 0, np.deg2rad(degrees), 0]))
    orientation = Rotation.from_matrix(matrix[:3, :3]).as_quat().tolist()
    return Edit(mounting_key(CAMERA), {"position": matrix[:3, 3].tolist(), "orientation": orientation})


TURNED = "looks 2.0 degrees away from where its mounting says"


@pytest.mark.parametrize(
    ("cures", "wanted"),
    [
        ([mounting(0.3)], "right"),
        ([mounting(0.7)], "wrong"),
        ([Edit(f"cameras.{CAMERA}.delay", 0.1)], "wrong"),
        ([Edit(f"cameras.{CAMERA}.delay", "soon")], "wrong"),  # no rig
        ([], "none"),
    ],
)
def test_a_cure_is_right_if_it_brings_the_truth_back(monkeypatch, cures, wanted):
    result = scored(monkeypatch, "camera turned", [finding(CAMERA, TURNED, *cures)])
    assert (result.found, result.cure, result.alarms) == (True, wanted, ())


def test_what_points_elsewhere_is_an_alarm_and_what_follows_is_not(monkeypatch):
    other = finding(CAMERA, TURNED)
    drift = finding("poses", "drift in height")
    result = scored(monkeypatch, "LiDAR turned", [other, drift])
    assert (result.found, result.noted, result.cure, len(result.alarms)) == (False, False, "", 1)
    assert "camera_front" in result.alarms[0]


def test_the_table_counts_by_strength(monkeypatch):
    found = scored(monkeypatch, "camera turned", [finding(CAMERA, TURNED, mounting(0.1))])
    missed = scored(monkeypatch, "camera turned", [], strength=0.5)
    text = report([found, missed, scored(monkeypatch, "", [finding(LIDAR, TURNED)])])
    assert "| camera turned | 2 deg | 1 | 1/1 | 0 | 1/1 | 0 |" in text
    assert "| camera turned | 0.5 deg | 1 | 0/1 | 0 | 0/0 | 0 |" in text
    assert "healthy logs with a false alarm | 1/1" in text
    assert "illnesses found or noted | 1/2 = 50%" in text


def test_a_run_resumes(monkeypatch, tmp_path):
    asked = []

    def patient(seed, cache, *, names):
        asked.append(seed)
        return SensorPatient(seed, DRIVE, CASE, None, 0.0)

    monkeypatch.setattr(trial, "patient", patient)
    monkeypatch.setattr(scoring, "check_sensors", lambda log, rig: [])
    SensorIllnesses(out=tmp_path, seed=1, logs=2).run()
    assert "3 logs of 1 drives" in SensorIllnesses(out=tmp_path, seed=1, logs=3).run()
    assert asked == [1, 2, 3]
    assert (tmp_path / "report.md").exists()
