"""Mode by the age of the inputs."""

from dataclasses import replace
from math import inf

import pytest

from offpiste.rig.outputs import Timeouts
from offpiste.runtime.modes import Ages, ModeDecision, decide_mode

WELL = Ages(state=0.0, scan=0.1, image=0.5, plan=0.1)


@pytest.mark.parametrize(
    ("changed", "mode", "why", "slow"),
    [
        ({}, "driving", "", False),
        ({"image": -inf}, "driving", "", False),
        ({"image": 1.6}, "degraded", "no image", False),
        ({"image": inf}, "degraded", "no image", False),
        ({"scan": 0.51}, "degraded", "late scan", True),
        ({"scan": 0.51, "image": inf}, "degraded", "late scan", True),
        ({"scan": 1.01}, "stopping", "no scan", False),
        ({"scan": inf, "plan": inf}, "stopping", "no scan", False),
        ({"plan": 0.51}, "stopping", "no plan", False),
        ({"state": 0.11, "scan": inf, "plan": inf}, "stopping", "no state of the vehicle", False),
    ],
)
def test_the_most_severe_fault_decides(changed, mode, why, slow):
    decision = decide_mode(replace(WELL, **changed), Timeouts(), map_empty=False, finished=False)
    assert decision == ModeDecision(mode, why, slow)


def test_an_empty_map_and_the_end_of_the_course_stop():
    assert decide_mode(WELL, Timeouts(), map_empty=True, finished=False).why == "empty map"
    assert decide_mode(WELL, Timeouts(), map_empty=True, finished=True) == ModeDecision("stopping", "end of the course")
