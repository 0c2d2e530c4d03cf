"""Ranges of valid values: those that drop measurements are widened, those that drop faults stay."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig

from offpiste.inspection.dropped import check_dropped
from offpiste.inspection.findings import Finding
from offpiste.inspection.recorded_log import RememberedLog, read_topics
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig

CLEAN = drive_log(seed=0)


def _rig(low: float, high: float) -> Rig:
    return rig(('fields = ["command"]', f'fields = ["command"]\nvalid = [{low}, {high}]'))


def _found(log: MemoryLog, of: Rig) -> list[Finding]:
    return check_dropped(read_topics(RememberedLog(log, of), of)[0], of)


@pytest.mark.parametrize("most", [0.3, 0.6])
def test_a_range_that_drops_measurements_is_widened_to_hold_all(most: float) -> None:
    (finding,) = _found(CLEAN, _rig(-most, most))
    assert (finding.severity, finding.where, finding.what) == ("warning", "steer", "valid drops measurements")
    values = CLEAN.data["steering"][1]["command"]
    assert f"{np.sum(np.abs(values) > most)} of {len(values)} samples" in finding.evidence
    cured = edited(_rig(-most, most), finding.cures[0])
    low, high = cured.channels["steer"].valid
    assert low < values.min() < values.max() < high
    assert _found(CLEAN, cured) == []


def test_faults_are_rightly_dropped() -> None:
    random = np.random.default_rng(0)

    def faulty(values: np.ndarray) -> np.ndarray:
        values[random.choice(len(values), 50, replace=False)] = 8.0
        values[300:400] = -5.0
        return values

    assert _found(CLEAN.change("steering", "command", faulty), _rig(-1.1, 1.1)) == []


def test_no_range_drops_nothing() -> None:
    assert _found(CLEAN, rig()) == []


def test_a_control_is_widened_to_its_whole_range_since_steps_may_hide_more_of_it() -> None:
    log = CLEAN.change("steering", "command", lambda x: np.where(x > 0.5, 1.0, x))  # a leap to the end
    (finding,) = _found(log, _rig(-0.3, 0.5))
    assert finding.cures == ((Edit("channels.steer.valid", [-1.1, 1.1]),),)
