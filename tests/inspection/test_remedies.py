"""The cure that explains most is found, and what would harm is not advised."""

from collections.abc import Sequence

import numpy as np
from simulated import drive_log, rig

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
