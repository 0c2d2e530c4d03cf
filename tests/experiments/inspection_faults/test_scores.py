"""Scores by hand: found, fixed and false alarms; the report; the commands from end to end."""

from dataclasses import replace

import numpy as np
import pytest

import experiments.inspection_faults.score as scoring
from experiments.arrays import save_arrays as save
from experiments.inspection_faults.__main__ import InspectionFaults
from experiments.inspection_faults.detectability import Detectability, warned
from experiments.inspection_faults.faults import FAULTS
from experiments.inspection_faults.report import report
from experiments.inspection_faults.score import FaultCase, FaultScore, Given, Score, score
from made_up_drive import made_up_case, made_up_drive
from offpiste.core.errors import OffpisteError
from offpiste.inspection.findings import Finding
from offpiste.rig.edits import Edit


def faulty_case(name="steer: sign"):
    fault = FAULTS[name]
    case = made_up_case(*fault.needed)
    given = Given(fault, fault.strengths[-1])
    faulty = fault.change(case, given.strength, np.random.default_rng(0))
    return FaultCase(7, made_up_drive(), faulty, case, faulty if fault.convention else case, (given,))


@pytest.fixture
def inspected_by(monkeypatch):
    """Replace the inspection by a function from rig to findings."""

    def use(findings):
        monkeypatch.setattr(scoring, "_inspected", lambda case: (tuple(findings(case.rig)), ""))

    return use


def finding(where, *fixes, severity="warning"):
    return Finding(severity, where, "is wrong", "1 of 1", "fix it", cures=fixes)


def test_the_first_fix_is_applied_and_the_log_is_healthy_again(inspected_by):
    case = faulty_case()
    right = -case.case.rig.channels["steer"].sign
    fix = (Edit("channels.steer.sign", right),)
    inspected_by(lambda rig: [finding("steer", fix)] if rig.channels["steer"].sign != right else [])
    result = score(case)
    (fault,) = result.faults
    assert (fault.found, fault.first_fix, result.false_alarms) == (True, "right", ())
    assert result.cost > 0.5
    assert result.after == pytest.approx(0, abs=0.02)


def test_a_scale_without_a_unit_costs_nothing_in_its_own_convention(inspected_by):
    inspected_by(lambda rig: [])
    result = score(faulty_case("throttle: scale"))
    assert result.cost == result.after == pytest.approx(0, abs=0.05)


def test_a_wrong_fix_no_fix_and_a_finding_elsewhere_are_told_apart(inspected_by):
    case = faulty_case()
    for fixes, wanted in (([(Edit("channels.steer.delay", 0.5),)], "wrong"), ([], "none")):
        inspected_by(lambda rig, fixes=fixes: [finding("steer", *fixes)])
        (fault,) = score(case).faults
        assert (fault.found, fault.first_fix) == (True, wanted)
    inspected_by(lambda rig: [finding("throttle"), finding("steer", severity="note")])
    result = score(case)
    (fault,) = result.faults
    assert (fault.found, fault.noted, fault.first_fix, len(result.false_alarms)) == (False, True, "", 1)


def test_an_exception_of_inspect_is_a_failure_and_no_finding(monkeypatch):
    monkeypatch.setattr(scoring, "inspect_log", lambda log, rig: 1 / 0)
    result = score(faulty_case())
    assert "ZeroDivisionError" in result.error
    assert not result.faults[0].found


def test_the_report_counts_by_fault_and_strength():
    def scored(seed, found, alarms=(), healthy=False):
        faults = () if healthy else (FaultScore("steer: sign", 1.0, True, found, False, "right"),)
        return Score(seed, "slow", faults, 0.5, 0.0, alarms, alarms)

    scores = [scored(i, found=i < 3) for i in range(4)]
    scores += [scored(10, found=False, healthy=True, alarms=("warning: steer",)), scored(11, False, healthy=True)]
    text = report(scores)
    assert "| steer: sign | 1 | 4 | +50% | 3/4 | 0 | 4/4 | +0% |" in text
    assert "| healthy logs with a false alarm | 1/2 = 50%" in text
    assert "- 3 (slow; cost +50%): steer: sign (1)" in text
    assert "- 10 (slow; cost +50%): warning: steer" in text


def test_the_command_resumes_and_reports(tmp_path):
    for seed in (1, 2):
        save(made_up_drive(), tmp_path / "drives" / f"drive-{seed:06d}.npz")
    settings = InspectionFaults(out=tmp_path, logs=1, fault=("steer: sign",))
    assert "1 logs: 0 healthy, 1 with one fault" in settings.run()
    lines = (tmp_path / "scores.jsonl").read_text().splitlines()
    # A killed process leaves half a line.
    (tmp_path / "scores.jsonl").write_text("\n".join((*lines, lines[0][:40])) + "\n")
    assert "2 logs: 0 healthy, 2 with one fault" in replace(settings, logs=2).run()
    assert (tmp_path / "scores.jsonl").read_text().startswith(lines[0])
    assert "steer: sign" in (tmp_path / "report.md").read_text()
    assert "truth: steer: sign" in replace(settings, only=2).run()
    assert "steer: sign" in replace(settings, list=True).run()
    with pytest.raises(OffpisteError, match="flu"):
        replace(settings, fault=("flu",)).run()


def test_an_error_as_large_as_the_scatter_warns_as_many_as_it_finds():
    # Healthy values are evenly spread over -1..1; an error of 0 changes nothing.
    healthy = np.linspace(-1, 1, 201)
    assert warned(healthy, (0.0,), found=0.5) == pytest.approx(0.5, abs=0.01)
    # Shifted by 1, distances are evenly spread over 0..2: half of them lie beyond 1, a tenth below 0.2.
    assert warned(healthy, (-1.0, 1.0), found=0.5) == pytest.approx(0, abs=0.01)
    assert warned(healthy, (-1.0, 1.0), found=0.9) == pytest.approx(0.8, abs=0.01)


def test_the_command_for_detectability_reports(tmp_path):
    for seed in (1, 2):
        save(made_up_drive(seconds=60, seed=seed), tmp_path / "drives" / f"drive-{seed:06d}.npz")
    text = Detectability(out=tmp_path, logs=2, seed=1).run()
    assert "What 2 drives can show" in text
    assert "steer: offset 0.02" in text
