"""The cure that explains most is found, and what would harm is not advised."""

from collections.abc import Sequence

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig

from offpiste.inspection.findings import Finding
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.remedies import explain
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig

CLEAN = drive_log(seconds=60)
SIGN = Edit("channels.steer.sign", -1)
UNIT = Edit("channels.throttle.unit", "percent")


def _warning(where: str, *cures: tuple[Edit, ...]) -> Finding:
    return Finding("warning", where, "is wrong", "seen", "fix it", 1.0, cures)


def _mock(rules: dict[str, Sequence[Edit]]) -> tuple[Rig, object]:
    """A log whose findings each vanish once the rig has some edits."""
    start = rig()

    def examine(now: Rig) -> tuple[Finding, ...]:
        return tuple(_warning(where, (SIGN,), (UNIT,)) for where, cures in rules.items() if edited(now, cures) != now)

    return start, examine


def test_one_cure_for_what_has_one_cause() -> None:
    start, examine = _mock({"steer": [UNIT], "yaw_rate": [UNIT], "brake": [UNIT]})
    (cause,) = explain(examine(start), start, examine)
    assert cause.cures == ((UNIT,),)
    assert len(cause.also) == 2
    assert cause.remedy == str(UNIT)


def test_a_cure_that_only_moves_what_is_wrong_is_not_advised() -> None:
    start = rig()

    def examine(now: Rig) -> tuple[Finding, ...]:
        return (_warning("steer", (SIGN,)),) if now.channels["steer"].sign == 1 else (_warning("yaw_rate", (UNIT,)),)

    (left,) = explain(examine(start), start, examine)
    assert (left.where, left.cures) == ("steer", ())


def test_a_cure_that_does_not_help_or_is_impossible_is_not_advised() -> None:
    start = rig()
    nothing = Edit("channels.steer.delay", 0.5)
    impossible = Edit("channels.position", None)

    def examine(now: Rig) -> tuple[Finding, ...]:
        more = (_warning("worse"),) if now.channels["steer"].sign == -1 else ()
        return (_warning("steer", (impossible,), (nothing,), (SIGN,)), *more)

    (left,) = explain(examine(start), start, examine)
    assert left.cures == ()
    assert "no entry of the rig" in left.remedy


def _swapped(log: MemoryLog) -> MemoryLog:
    _, odom = log.data["odom"]
    x, y = odom["x"].copy(), odom["y"].copy()
    return log.change("odom", "x", lambda _: y).change("odom", "y", lambda _: x)


def _shuffled(log: MemoryLog) -> MemoryLog:
    order = np.random.default_rng(0).permutation(len(log.data["odom"][0]))
    return log.keep("odom", order)


@pytest.mark.parametrize(
    ("log", "cure"),
    [
        (_swapped(CLEAN), (Edit("channels.position.fields", ["y", "x", "z"]),)),
        (_shuffled(CLEAN), (Edit("clock.sort", True),)),
        (
            CLEAN.restamp("odom", lambda t: t - 0.6),
            (Edit("channels.position.delay", -0.6), Edit("channels.orientation.delay", -0.6)),
        ),
    ],
    ids=["swapped axes", "shuffled rows", "early poses"],
)
def test_a_cause_that_shows_everywhere_has_one_cure(log: MemoryLog, cure: tuple[Edit, ...]) -> None:
    found = inspect_log(log, rig())
    applied = {edit.key: edit.value for edit in found.cure}
    assert set(applied) >= {edit.key for edit in cure}
    for edit in cure:
        if isinstance(edit.value, float):
            # Remedies leave the delay that vehicles have in the middle; this one has hardly any.
            assert applied[edit.key] == pytest.approx(edit.value, abs=0.15)
        else:
            assert applied[edit.key] == edit.value
    after = inspect_log(log, edited(rig(), found.cure))
    assert [f for f in after.findings if f.severity != "note"] == []


def test_every_cure_that_is_printed_can_be_applied_and_silences_its_finding() -> None:
    log = CLEAN.change("steering", "command", np.negative).change("pedals", "throttle", lambda x: 100 * x)
    now = rig()
    findings = inspect_log(log, now).findings
    assert len(findings) == 2
    for finding in findings:
        now = edited(now, finding.cures[0])
        left = {(f.where, f.what) for f in inspect_log(log, now).findings}
        assert (finding.where, finding.what) not in left


@pytest.mark.parametrize("now", [rig(), None], ids=["a rig", "no rig"])
def test_a_log_whose_samples_are_all_out_of_order_is_sorted(now: Rig | None) -> None:
    log = CLEAN
    for topic, (time, _) in CLEAN.data.items():
        log = log.keep(topic, np.random.default_rng(0).permutation(len(time)))
    found = inspect_log(log, now)
    assert found.cure == (Edit("clock.sort", True),)
    assert not [f for f in found.findings if "unit" in f.what]


def test_a_pose_that_is_mirrored_is_named_beside_the_cures_of_what_turns_against_it() -> None:
    log = CLEAN
    log = log.change("odom", "y qz qx", np.negative)
    findings = inspect_log(log, rig()).findings
    keys = {edit.key for finding in findings for cure in finding.cures[:1] for edit in cure}
    assert any(key.endswith("steer.sign") or key.endswith("steer_angle.sign") for key in keys)
    (mirrored,) = (finding for finding in findings if finding.what == "may be seen in a mirror")
    assert mirrored.severity == "note"
    assert mirrored.evidence.startswith("steer, ")
    assert not any(finding.what.endswith("mirror") for finding in inspect_log(CLEAN, rig()).findings)
    one = CLEAN.change("steering", "command", np.negative).change("steering", "angle", np.negative)
    assert not any(finding.what.endswith("mirror") for finding in inspect_log(one, rig()).findings)
