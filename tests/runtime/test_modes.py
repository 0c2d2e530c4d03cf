"""Mode by the age of the inputs."""

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
        ({"map_empty": True}, "stopping", "empty map", False),
        ({"map_empty": True, "finished": True}, "stopping", "end of the course", False),
    ],
)
def test_the_most_severe_fault_decides(changed, mode, why, slow):
    found = {"map_empty": False, "finished": False, **vars(WELL), **changed}
    ages = Ages(*(found.pop(name) for name in vars(WELL)))
    assert decide_mode(ages, Timeouts(), **found) == ModeDecision(mode, why, slow)
