"""Scores by hand: what counts as found, as a false alarm and as cured; the table, and the command from end to end."""

from dataclasses import replace

import numpy as np
import pytest

import experiments.illnesses.score as scoring
from experiments.illnesses.__main__ import Illnesses
from experiments.illnesses.cases import Given, Patient
from experiments.illnesses.illness import ILLNESSES
from experiments.illnesses.score import IllnessScore, Score, points_to, score
from experiments.illnesses.table import report
from experiments.illnesses.true_drive import save
from made_up_drive import made_up_case, made_up_drive
from offpiste.core.errors import OffpisteError
from offpiste.inspection.findings import Finding
from offpiste.rig.edits import Edit


def ill_patient(name="steer: sign"):
    one = ILLNESSES[name]
    case = made_up_case(*one.needs)
    given = Given(one, one.strengths[-1])
    ill = one.change(case, given.strength, np.random.default_rng(0))
    return Patient(7, made_up_drive(), ill, case, (given,))


class Inspection:
    """Reports the findings of a function of the rig."""

    def __init__(self, findings):
        self.findings = tuple(findings)


def inspected_by(monkeypatch, findings):
    monkeypatch.setattr(scoring, "inspect_log", lambda log, rig: Inspection(findings(rig)))


def finding(where, *cures, severity="warning"):
    return Finding(severity, where, "is ill", "1 of 1", "see a doctor", cures=cures)


def test_the_first_cure_is_applied_and_the_log_is_healthy_again(monkeypatch):
    patient = ill_patient()
    right = -patient.case.rig.channels["steer"].sign
    cure = (Edit("channels.steer.sign", right),)
    inspected_by(monkeypatch, lambda rig: [finding("steer", cure)] if rig.channels["steer"].sign != right else [])
    result = score(patient, patient.case.log, storage="memory")
    (ill,) = result.illnesses
    assert (ill.found, ill.first_cure, result.false_alarms, result.error) == (True, "right", (), "")
    assert result.cost > 0.5
    assert result.after == pytest.approx(0, abs=0.02)


def test_a_scale_without_a_unit_costs_nothing_in_its_own_convention(monkeypatch):
    patient = ill_patient("throttle: scale")
    assert patient.conventional.values("throttle").max() == pytest.approx(patient.case.values("throttle").max())
    inspected_by(monkeypatch, lambda rig: [])
    result = score(patient, patient.case.log, storage="memory")
    assert abs(result.cost) > 0.2  # by another convention, the error is another
    assert result.own_cost == result.own_after == pytest.approx(0, abs=0.05)


def test_a_wrong_cure_no_cure_and_a_finding_elsewhere_are_told_apart(monkeypatch):
    patient = ill_patient()
    for cures, wanted in (([(Edit("channels.steer.delay", 0.5),)], "wrong"), ([], "none")):
        inspected_by(monkeypatch, lambda rig, cures=cures: [finding("steer", *cures)])
        (ill,) = score(patient, patient.case.log, storage="memory").illnesses
        assert (ill.found, ill.first_cure) == (True, wanted)
    inspected_by(monkeypatch, lambda rig: [finding("throttle"), finding("steer", severity="note")])
    result = score(patient, patient.case.log, storage="memory")
    (ill,) = result.illnesses
    assert (ill.found, ill.noted, ill.first_cure) == (False, True, "")
    assert len(result.false_alarms) == 1


def test_an_exception_of_inspect_is_a_failure_and_no_finding(monkeypatch):
    def fails(rig):
        raise ZeroDivisionError("oh")

    patient = ill_patient()
    inspected_by(monkeypatch, fails)
    result = score(patient, patient.case.log, storage="memory")
    assert "ZeroDivisionError: oh" in result.error
    assert not result.illnesses[0].found


def test_any_warning_on_a_healthy_log_is_a_false_alarm(monkeypatch):
    patient = ill_patient("wrong mass")
    inspected_by(
        monkeypatch, lambda rig: [finding("steer"), finding("log", severity="fatal"), finding("x", severity="note")]
    )
    result = score(patient, patient.case.log, storage="memory")
    assert result.illnesses == ()
    assert len(result.false_alarms) == 2


def test_findings_point_to_channels_fields_and_topics():
    case = next(c for c in (made_up_case("steer", seed=s) for s in range(20)) if "command" in c.streams)
    for where in ("steer", "steer (command steer)", "command", "wheels, command"):
        assert points_to(finding(where), ("steer",), case), where
    assert not points_to(finding("steer_angle"), ("steer",), case)
    assert not points_to(finding("imu"), ("steer",), case)


def made_up_score(seed, *, found, cost=0.5, alarms=(), cure="right", healthy=False):
    ill = IllnessScore("steer: sign", 1.0, "channel", True, found, False, cure)
    return Score(
        seed=seed, body="", behaviour="ordinary", storage="memory", illnesses=() if healthy else (ill,), harmless=(),
        cost=cost, after=0.0, distance=1.0, false_alarms=alarms, findings=alarms,
    )  # fmt: skip


def test_the_report_counts_what_is_found_by_illness_and_strength():
    scores = [made_up_score(i, found=i < 3) for i in range(4)]
    scores += [
        made_up_score(10 + i, found=False, healthy=True, alarms=("warning: steer",) * (i == 0)) for i in range(2)
    ]
    text = report(scores)
    assert "| channel | steer: sign | 1 | 4 | +50% | 3/4 | 0 | 4/4 | +0% | 0 |" in text
    assert "1/2 = 50%" in text
    assert "- 3 (ordinary, memory): steer: sign (1), cost +50%" in text
    assert "- 10 (ordinary, memory): warning: steer" in text


def test_the_command_resumes_and_reports(tmp_path, capsys):
    drives = tmp_path / "drives"
    for seed in (1, 2):
        save(made_up_drive(), drives / f"drive-{seed:06d}.npz")
    settings = Illnesses(out=tmp_path, logs=1, illness=("steer: sign",), files=1.0)
    assert "1 logs: 0 healthy, 1 with one illness" in settings.run()
    lines = (tmp_path / "scores.jsonl").read_text().splitlines()
    # A killed process leaves half a line.
    (tmp_path / "scores.jsonl").write_text("\n".join((*lines, lines[0][:40])) + "\n")
    assert "2 logs: 0 healthy, 2 with one illness" in replace(settings, logs=2).run()
    assert (tmp_path / "scores.jsonl").read_text().startswith(lines[0])
    assert "steer: sign" in (tmp_path / "report.md").read_text()
    assert replace(settings, only=2).run() is None
    assert "truth: steer: sign" in capsys.readouterr().out
    assert "steer: sign" in replace(settings, list=True).run()
    with pytest.raises(OffpisteError, match="flu"):
        replace(settings, illness=("flu",)).run()
