"""What people and machines get to see."""

import json
from dataclasses import replace

import numpy as np
from simulated import drive_log, rig

from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.render import render_text


def test_people_read_the_worst_first_with_evidence_and_remedy() -> None:
    log = drive_log(seconds=60).change("steering", "command", np.negative)
    text = render_text(inspect_log(log, rig()))
    assert "1. warning  steer: is positive to the right" in text
    assert "fix: channels.steer.sign = -1" in text
    assert text.rstrip().endswith("usable for training (1 warning)")
    assert "50.0" in text  # a topic's rate


def test_a_log_that_a_cure_makes_usable_is_not_given_up() -> None:
    log = drive_log(seconds=60).change("odom", "x", lambda x: 100 * x).change("odom", "y", lambda y: 100 * y)
    inspection = inspect_log(log, rig())
    fatal = [finding for finding in inspection.findings if finding.severity == "fatal"]
    assert fatal
    assert all(finding.cures for finding in fatal)
    assert "NOT usable for training until cured as said above (" in render_text(inspection)
    uncured = replace(inspection, findings=(replace(fatal[0], cures=()),))
    assert "NOT usable for training (1 fatal)" in render_text(uncured)


def test_machines_get_plain_json() -> None:
    log = drive_log(seconds=60).change("steering", "command", np.negative)
    found = json.loads(json.dumps(inspect_log(log, rig()).as_dict(), allow_nan=False))
    assert found["usable"] is True
    assert found["findings"][0]["remedy"] == "channels.steer.sign = -1"
    assert found["summary"]["distance"] > 100
    assert {row["name"] for row in found["topics"]} == {"odom", "pedals", "steering", "wheels"}
