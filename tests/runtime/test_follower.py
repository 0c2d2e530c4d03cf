"""Mode by the age of the inputs, and the schedule of controls."""

from math import inf

import numpy as np
import pytest
import torch

from offpiste.core.conventions import DT
from offpiste.rig.outputs import Timeouts
from offpiste.runtime.follower import Schedule, TimedPlan
from offpiste.runtime.modes import Ages, ModeDecision, decide_mode
from offpiste.runtime.prediction import Prediction

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


def plan(start, first, steps=5):
    """Throttle counts steps from `first`."""
    controls = torch.zeros(steps, 3)
    controls[:, 0] = first + torch.arange(steps)
    return TimedPlan(start, start, controls, Prediction(start, np.zeros((steps, 6))))


def test_a_later_plan_acts_instead_of_the_earlier_from_its_start_on():
    schedule = Schedule()
    assert schedule.control(0.0) is None
    assert schedule.acting(0.0) is None
    schedule.add(plan(0.10, 0.0))
    schedule.add(plan(0.14, 100.0))
    assert schedule.control(0.08) is None
    due = [schedule.control(0.10 + DT * row)[0] for row in range(8)]
    assert due == [0, 1, 100, 101, 102, 103, 104, 104]  # the last one is held
    assert schedule.acting(0.12).start == 0.10
    assert schedule.acting(0.20).start == 0.14


def test_the_next_plan_begins_with_what_is_left():
    assert plan(0.0, 0.0).continued(0.06)[:, 0].tolist() == [3, 4, 4, 4, 4]
    assert plan(0.0, 0.0).continued(1e3)[:, 0].tolist() == [4] * 5


def test_stamps_of_this_century_do_not_shift_steps():
    begin = 1_700_000_000.0
    schedule = Schedule()
    schedule.add(plan(begin + 0.1, 0.0, steps=250))
    for row in range(250):
        assert schedule.control(begin + 0.1 + row * DT)[0] == row
