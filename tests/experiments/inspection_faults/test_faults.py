"""Every fault changes a case, repeatably; healthy changes do not; the edit that undoes a fault restores the rows."""

import numpy as np
import pytest

from experiments.arrays import save_arrays as save
from experiments.inspection_faults.cost import distance, is_fixed, rows_of
from experiments.inspection_faults.faults import FAULTS
from experiments.inspection_faults.score import fault_case
from made_up_drive import made_up_case, made_up_drive
from offpiste.core.errors import OffpisteError


def case_for(name, seed=0):
    return made_up_case(*FAULTS[name].needed, seed=seed)


def numbers(case):
    """All that a fault may change."""
    streams = {
        name: (s.time.tobytes(), *map(np.ndarray.tobytes, s.columns.values())) for name, s in case.streams.items()
    }
    return case.rig, streams


@pytest.mark.parametrize("kind", ["channel", "stamps", "pose", "rig", "healthy"])
def test_every_fault_changes_the_case_and_the_same_seed_gives_the_same(kind):
    for name, fault in FAULTS.items():
        if fault.kind == kind:
            case = case_for(name)
            for strength in fault.strengths:
                once, again = (numbers(fault.change(case, strength, np.random.default_rng(1))) for _ in range(2))
                assert once != numbers(case), (name, strength)
                assert once == again, (name, strength)


def test_healthy_changes_leave_the_rows_as_they_are():
    for name, one in FAULTS.items():
        if one.kind == "healthy" and name != "wrong mass":
            case = case_for(name)
            changed = one.change(case, one.strengths[-1], np.random.default_rng(1))
            assert distance(rows_of(changed), rows_of(case)) < 0.15, name


FIXES = {
    "steer: sign": lambda rig: [("channels.steer.sign", -rig.channels["steer"].sign)],
    "throttle: the wrong way round": lambda rig: [
        ("channels.throttle.scale", -rig.channels["throttle"].scale),
        ("channels.throttle.offset", 1 - rig.channels["throttle"].offset),
    ],
    "yaw: sign": lambda rig: [("channels.yaw.sign", -rig.channels["yaw"].sign)],
    "linear_velocity: frame": lambda rig: [("channels.linear_velocity.frame", "unknown")],
}


@pytest.mark.parametrize("name", FIXES)
def test_the_edit_that_undoes_a_fault_is_a_fix_and_another_is_not(name):
    fault = FAULTS[name]
    # Units of a percent would have another offset.
    case = next(c for c in (case_for(name, seed) for seed in range(30)) if not c.source(fault.places[0]).unit)
    faulty = fault.change(case, fault.strengths[-1], np.random.default_rng(1))
    healthy = rows_of(case)
    before = distance(rows_of(faulty), healthy)
    assert before > 0.1
    assert is_fixed(distance(rows_of(faulty.with_rig(*FIXES[name](faulty.rig))), healthy), before)
    assert not is_fixed(distance(rows_of(faulty.with_rig(("vehicle.mass", 1.0))), healthy), before)


def test_a_seed_is_one_case_and_a_choice_is_kept(tmp_path):
    for seed in range(8):
        save(made_up_drive(), tmp_path / f"drive-{seed:06d}.npz")
        one, again = (fault_case(seed, tmp_path) for _ in range(2))
        assert (one.given, numbers(one.case)) == (again.given, numbers(again.case))
        (given,) = fault_case(seed, tmp_path, ["steer: sign"]).given
        assert given.fault.name == "steer: sign"
        assert fault_case(seed, tmp_path, healthy=True).given == ()
    with pytest.raises(OffpisteError, match="no fault 'flu'"):
        fault_case(0, tmp_path, ["flu"])
