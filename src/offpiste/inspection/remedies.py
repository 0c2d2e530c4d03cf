"""Search for the fixes that explain most findings, each tested by inspecting the log with it.

Findings propose edits of the rig; swapped columns and a common delay of several channels are tested as well. The fix
with the smallest remaining badness is accepted, the findings that it removes are attributed to the same cause, and the
search continues with the edited rig. Fixes that do not help or cause new findings are not recommended.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import permutations
from typing import Final

import msgspec
import numpy as np

from offpiste.core.errors import OffpisteError
from offpiste.inspection.course import against_names
from offpiste.inspection.findings import Cure, Finding, found, ranked
from offpiste.logs.channel import turning_sign
from offpiste.rig.channels import GEOGRAPHIC, unit_factor
from offpiste.rig.edits import Edit, edited, rounded
from offpiste.rig.rig import Rig

Examine = Callable[[Rig], tuple[Finding, ...]]
"""Function that returns the findings of a log for a given rig."""

_WEIGHTS: Final = {"fatal": 100.0, "warning": 1.0, "note": 0.05}
_PER_EDIT: Final = 0.1
"""Penalty in badness for each fault that a fix implies."""
_LEAST_GAIN: Final = 0.4
"""Minimum gain in badness of a recommended fix."""
_TURNED: Final = {"yaw", "orientation", "steer", "steer_angle", "yaw_rate", "angular_velocity", "linear_velocity"}
"""Locations of findings that a pose with wrong axes causes."""
_TURNING: Final = (("steer", "steer_angle"), ("yaw_rate", "angular_velocity"))
"""Channels that measure turning; channels of one group may share a sensor."""
_ROUNDS: Final = 6
_MOST: Final = 16
"""Maximum number of fixes tested per round."""
_FEW: Final = 2
"""Maximum number of fixes tested as the first of two."""


def explain(findings: Sequence[Finding], rig: Rig, examine: Examine) -> tuple[Finding, ...]:
    """Group findings by cause, in the order in which to fix them.

    Args:
        examine: returns the findings with another rig.

    Returns:
        For each cause, its worst finding with the tested fix as remedy and the other findings that it removes; then the
        remaining findings, without fixes that failed. Findings that appear only after others are fixed are included.
    """
    left, current, examine = tuple(findings), rig, _remembering(examine)
    causes: list[Finding] = []
    for _ in range(_ROUNDS):
        best = _best_cure(left, current, examine) or _first_of_two(left, current, examine)
        if best is None:
            break
        cure, after = best
        causes.append(_cause(cure, left, after))
        left, current = after, edited(current, cure)
    kept = ranked(_checked(finding, left, current, examine) for finding in left)
    # Fatal findings without a fix come first.
    fatal = [finding for finding in kept if finding.severity == "fatal"]
    return (*fatal, *causes, *_mirrored(causes, rig), *(finding for finding in kept if finding.severity != "fatal"))


def badness(findings: Sequence[Finding]) -> float:
    """Return the total badness of findings."""
    return sum((_WEIGHTS[f.severity] * (1 + (f.score if f.severity == "warning" else 0)) for f in findings), 0.0)


def _mirrored(causes: Sequence[Finding], rig: Rig) -> list[Finding]:
    """Return a finding if several channels turn opposite to the pose, so that their signs or the pose are mirrored.

    With latitude and longitude, headings are clockwise. A heading that needs no sign change indicates longitudes
    that are positive to the west.
    """
    edits = [edit for cause in causes for cure in cause.cures[:1] for edit in cure]
    keys = {edit.key for edit in edits}
    against = [names[0] for names in _TURNING if {f"channels.{name}.sign" for name in names} & keys]
    against += ["linear_velocity"] * any((edit.key, edit.value) == ("motion.axes", "body down") for edit in edits)
    if len(against) < 2 or keys & {"channels.yaw.sign", "channels.position.fields"}:
        return []
    yaw, geographic = rig.channels.get("yaw"), rig.channels["position"].unit == GEOGRAPHIC
    west = geographic and yaw is not None and yaw.sign > 0 and rig.motion.axes == "z up"
    about = {"channels": ", ".join(against)}
    return [found("mirrored_longitudes" if west else "mirrored_pose", "position", about)]


def _best_cure(left: Sequence[Finding], rig: Rig, examine: Examine) -> tuple[Cure, tuple[Finding, ...]] | None:
    """Return the fix with the smallest remaining badness and its findings, or None if no fix is worthwhile."""
    serious = [finding for finding in left if finding.severity != "note"]
    if not serious:
        return None
    best, least = None, badness(left) - _LEAST_GAIN
    seen = {cure for finding in left if finding.code == "exchanged" for cure in finding.cures}
    for cure in _distinct(serious, rig):
        try:
            after = examine(edited(rig, cure))
        except OffpisteError:
            continue  # the rig does not allow this edit
        remains = badness(after) + _PER_EDIT * _size(cure, rig)
        remains += 0.0 if cure in seen else against_names(cure, rig)
        if remains < least - 1e-9 and not _hides_motion(left, after):
            best, least = (cure, after), remains
            if remains < _PER_EDIT + badness([finding for finding in after if finding.severity == "note"]) + 1e-9:
                break  # one fault explains everything
    return best


def _first_of_two(left: Sequence[Finding], rig: Rig, examine: Examine) -> tuple[Cure, tuple[Finding, ...]] | None:
    """Return the first of the two best fixes and the findings after it, if it removes its own finding.

    Two faults can mask each other: after the first is fixed, the second appears with similar badness.
    """
    proposed = [(finding, cure) for finding in left if finding.severity != "note" for cure in finding.cures[:_MOST]]
    firsts: list[tuple[Cure, tuple[Finding, ...]]] = []
    for finding, cure in proposed:
        try:
            after = examine(edited(rig, cure))
        except OffpisteError:
            continue
        if not _is_among(finding, after) and not _hides_motion(left, after):
            firsts.append((cure, after))
    best, least = None, badness(left) - 2 * _LEAST_GAIN
    for cure, after in sorted(firsts, key=lambda first: badness(first[1]))[:_FEW]:
        cured = edited(rig, cure)
        second = _best_cure(after, cured, examine)
        if second is None:
            continue
        remains = badness(second[1]) + _PER_EDIT * (_size(cure, rig) + _size(second[0], cured))
        if remains < least - 1e-9:
            best, least = (cure, after), remains
    return best


def _hides_motion(before: Sequence[Finding], after: Sequence[Finding]) -> bool:
    """Return whether a fix breaks the pose, which removes findings by preventing comparisons with the motion."""
    now, then = ({f.where for f in each if f.severity == "fatal"} <= {"controls"} for each in (before, after))
    upright, on_its_side = ("tipped" not in {f.code for f in before}), ("tipped" in {f.code for f in after})
    return (now and not then) or (upright and on_its_side)


def _remembering(examine: Examine) -> Examine:
    """Return the function with its results cached by rig."""
    known: dict[bytes, tuple[Finding, ...]] = {}

    def remembered(rig: Rig) -> tuple[Finding, ...]:
        key = msgspec.json.encode(rig)
        if key not in known:
            known[key] = examine(rig)
        return known[key]

    return remembered


def _is_among(finding: Finding, findings: Sequence[Finding]) -> bool:
    return (finding.where, finding.what) in {(other.where, other.what) for other in findings}


def _size(cure: Cure, rig: Rig) -> int:
    """Return the number of faults that a fix implies, counting an entry of all channels of a topic once.

    Scale and offset of one channel count as one fault.
    """
    things, keys = set(), {edit.key for edit in cure}
    for edit in cure:
        table, _, entry = edit.key.rpartition(".")
        entry = "scale" if entry == "offset" and f"{table}.scale" in keys else entry
        channel = rig.channels.get(table.removeprefix("channels."))
        things.add((table if channel is None else channel.topic, entry))
    return len(things)


def _distinct(findings: Sequence[Finding], rig: Rig) -> list[Cure]:
    """Return the fixes to test; the first of equally good ones wins."""
    cures = dict.fromkeys(cure for finding in findings for cure in finding.cures)
    cures |= dict.fromkeys(_hypotheses(findings, rig))
    return [*cures][:_MOST]


def _hypotheses(findings: Sequence[Finding], rig: Rig) -> Iterator[Cure]:
    """Yield fixes for causes that no single finding shows."""
    delays = _delays(findings)
    if len(delays) > 1:
        yield tuple(delays)
    places = {finding.where.split(" ")[0] for finding in findings}
    fields = rig.channels["position"].fields
    if "position" in places:
        others = list(permutations(fields))[1:]
        if rig.channels["position"].unit == GEOGRAPHIC:  # the height is not in degrees
            others = [(fields[1], fields[0], *fields[2:])]
        yield from ((Edit("channels.position.fields", list(other)),) for other in others)
    elif places & _TURNED:
        yield (Edit("channels.position.fields", [fields[1], fields[0], *fields[2:]]),)
        yield from _compass(rig)
    pedals = {"throttle", "brake"}
    together = any(_channels(cure) == pedals for finding in findings for cure in finding.cures)
    if pedals <= places & set(rig.channels) and not together:
        yield _swapped("throttle", "brake", rig)


def _channels(cure: Cure) -> set[str]:
    """Return the channels whose entries a fix sets."""
    return {edit.key.split(".")[1] for edit in cure if edit.key.startswith("channels.")}


def _compass(rig: Rig) -> Iterator[Cure]:
    """Yield fixes for a clockwise yaw, from north or from x; along a diagonal it still follows the course."""
    source = rig.channels.get("yaw")
    if source is not None:
        flipped = Edit("channels.yaw.sign", -source.sign)
        quarter = np.pi / 2 / (source.sign * unit_factor("yaw", source.unit)) * turning_sign("yaw", rig.motion.axes)
        yield flipped, Edit("channels.yaw.offset", rounded(source.offset - quarter))
        yield (flipped,)


def _delays(findings: Sequence[Finding]) -> list[Edit]:
    """Return the first proposed delay edits of all findings."""
    return [e for f in findings for cure in f.cures[:1] for e in cure if e.key.endswith(".delay")]


def _swapped(one: str, other: str, rig: Rig) -> Cure:
    """Return the edits that swap the sources of two channels, including units and scales."""
    first, second = rig.channels[one], rig.channels[other]
    return tuple(
        Edit(f"channels.{name}.{key}", list(new) if isinstance(new, tuple) else new)
        for name, source, old in ((one, second, first), (other, first, second))
        for key in ("topic", "fields", "unit", "scale", "offset", "sign")
        if (new := getattr(source, key)) != getattr(old, key)
    )


def _cause(cure: Cure, before: Sequence[Finding], after: Sequence[Finding]) -> Finding:
    """Return the worst finding that a fix removes, preferably one that proposed it, with the others attached."""
    gone = [f for f in before if not _is_among(f, after) and f.severity != "note"]
    own = [f for f in before if cure in f.cures]
    worst = ranked(gone or own)[0] if gone or own else before[0]
    head = next((f for f in own if f.severity == worst.severity), worst)
    also = tuple(f"{f.where} {f.what}" for f in gone if f is not head)
    tail = head.remedy.partition("; ")[2] if head.cures[:1] == (cure,) else ""
    remedy = ", ".join(map(str, cure)) + (f"; {tail}" if tail else "")
    return replace(head, remedy=remedy, cures=(cure,), also=also)


def _checked(finding: Finding, left: Sequence[Finding], rig: Rig, examine: Examine) -> Finding:
    """Return a finding without its harmful fixes; an unsure finding becomes a note if no fix remains."""
    harmless = tuple(cure for cure in finding.cures if not _harms(cure, left, rig, examine))
    if harmless == finding.cures:
        return finding if harmless or finding.sure else replace(finding, severity="note")
    if harmless:
        return replace(finding, remedy=", ".join(map(str, harmless[0])), cures=harmless)
    how = "no entry of the rig is sure to cure it: look at the data around it, or leave the channel out"
    severity = finding.severity if finding.sure else "note"
    return replace(finding, severity=severity, remedy=how, cures=())


def _harms(cure: Cure, left: Sequence[Finding], rig: Rig, examine: Examine) -> bool:
    """Return whether a fix worsens the findings, or does not help although a warning proposed it."""
    try:
        after = examine(edited(rig, cure))
    except OffpisteError:
        return True
    before, now = (badness([f for f in each if f.severity != "note"]) for each in (left, after))
    wanted = any(cure in f.cures and f.severity != "note" for f in left)
    return _hides_motion(left, after) or now > before - (_LEAST_GAIN if wanted else 0.0)
