"""Cases with known faults, and what `inspect` finds in them: faults found and fixed, false alarms, costs."""

import traceback
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from experiments.inspection_faults.cost import COSTLY, UNREADABLE, cost_of, distance, error_after, is_fixed, rows_of
from experiments.inspection_faults.drives import TrueDrive, drive_of
from experiments.inspection_faults.faults import FAULTS, Fault, fault_named
from experiments.inspection_faults.recording import Case, recorded
from offpiste.core.errors import OffpisteError
from offpiste.inspection.findings import Finding
from offpiste.inspection.inspect import inspect_log
from offpiste.rig.edits import edited

_HEALTHY, _CHANGED = 0.3, 0.3
"""Share of healthy cases, and of healthy changes among them."""
_COUNTS: Final = (0.8, 0.13, 0.07)
"""Shares of one, two and three faults."""
_EITHER: Final = ({"orientation", "yaw"}, {"yaw_rate", "angular_velocity"}, {"yaw", "angular_velocity"})
"""Channels of which a recording has one."""
_ROUNDS: Final = 5
_ANYWHERE: Final = ("log", "table")
"""Places of a finding about the whole recording."""


@dataclass(frozen=True)
class Given:
    """A fault at a strength."""

    fault: Fault
    strength: float

    def __str__(self) -> str:
        return f"{self.fault.name} ({self.strength:g} {self.fault.unit})".replace(" )", ")")


@dataclass(frozen=True)
class FaultCase:
    """A case with its truth."""

    seed: int
    drive: TrueDrive
    case: Case  # as it is inspected
    healthy: Case  # before any fault
    conventional: Case  # healthy, but recorded in the conventions of the case (`Fault.convention`)
    given: tuple[Given, ...]  # faults, in order of application
    changes: tuple[Given, ...] = ()  # changes that are no faults


def fault_case(seed: int, cache: Path, names: Sequence[str] = (), *, healthy: bool = False) -> FaultCase:
    """Return the case of a seed.

    Args:
        cache: folder of simulated drives.
        names: faults to choose from, one per case; all by default, and then some cases are healthy or have several.
    """
    random = np.random.default_rng([seed, 0x111])
    given: tuple[Given, ...] = ()
    changes: tuple[Given, ...] = ()
    if healthy or (not names and random.random() < _HEALTHY):
        if random.random() < _CHANGED:
            changes = _some(random, [fault for fault in FAULTS.values() if fault.kind == "healthy"], 1)
    elif names:
        given = _some(random, [fault_named(name) for name in names], 1)
    else:
        count = 1 + int(random.choice(len(_COUNTS), p=_COUNTS))
        given = _some(random, [fault for fault in FAULTS.values() if fault.kind != "healthy"], count)
    drive = drive_of(seed, cache)
    case = recorded(drive, random, {need for one in (*given, *changes) for need in one.fault.needed})
    for one in changes:
        case = one.fault.change(case, one.strength, random)
    well = conventional = case
    for one in given:
        case = one.fault.change(case, one.strength, random)
        if one.fault.convention:
            conventional = one.fault.change(conventional, one.strength, random)
    return FaultCase(seed, drive, case, well, conventional, given, changes)


def _some(random: np.random.Generator, choices: Sequence[Fault], count: int) -> tuple[Given, ...]:
    """Faults that share no place, so that each can be recognised, and that one recording can have."""
    chosen: list[Fault] = []
    for number in random.permutation(len(choices)):
        fault = choices[int(number)]
        taken = {place for other in chosen for place in (*other.places, *other.needed)}
        needed = {need for other in (fault, *chosen) for need in other.needed}
        if not taken & {*fault.places, *fault.needed} and not any(pair <= needed for pair in _EITHER):
            chosen.append(fault)
        if len(chosen) == count:
            break
    return tuple(Given(fault, float(random.choice(fault.strengths))) for fault in chosen)


@dataclass(frozen=True)
class FaultScore:
    """What became of one fault."""

    name: str
    strength: float
    fixable: bool
    found: bool  # whether a warning or fatal finding points to one of its places
    noted: bool  # whether only a note does
    first_fix: str  # "right", "wrong", "none" (of the first finding about it), "" where not found or not fixable


@dataclass(frozen=True)
class Score:
    """Result of one case; costs are None where the healthy log has too few windows."""

    seed: int
    drive: str
    faults: tuple[FaultScore, ...]  # none for a healthy case
    cost: float | None  # `cost.cost_of`
    after: float | None  # after all fixes
    false_alarms: tuple[str, ...]  # warnings and fatal findings that point elsewhere
    findings: tuple[str, ...]
    error: str = ""  # exception of `inspect`


def serious(findings: Sequence[Finding]) -> list[Finding]:
    """Warnings and fatal findings."""
    return [finding for finding in findings if finding.severity != "note"]


def in_words(finding: Finding) -> str:
    """A finding in one line."""
    return f"{finding.severity}: {finding.where}: {finding.what} [{finding.evidence}] -> {finding.remedy}"


def points_to(finding: Finding, channels: Sequence[str], case: Case) -> bool:
    """Whether a finding points to one of these channels, or a topic of one: by its place, its cause or its fix."""
    topics = {case.source(channel).topic or "table" for channel in channels if case.has(channel)}
    named = {part.split(" ")[0] for place in (finding.where, *finding.also) for part in place.split(", ")}
    fixed = {edit.key.split(".")[1] for fix in finding.cures[:1] for edit in fix if edit.key.startswith("channels.")}
    return bool((named | fixed) & {*channels, *topics})


def score(one: FaultCase) -> Score:
    """Inspect a case and compare the findings with its truth."""
    findings, error = _inspected(one.case)
    alarms = tuple(in_words(finding) for finding in serious(findings) if not _explained(finding, one))
    drive = f"{one.drive.behaviour}, wheelbase {one.drive.wheelbase:.2f} m, {one.drive.seconds:.0f} s"
    result = Score(one.seed, drive, (), 0.0, 0.0, alarms, tuple(map(in_words, findings)), error)
    if not one.given:
        return result
    healthy, conventional, faulty = rows_of(one.healthy), rows_of(one.conventional), rows_of(one.case)
    if healthy is None or conventional is None:
        return replace(result, faults=tuple(_fault_score(given, one, findings) for given in one.given), cost=None,
                       after=None)  # fmt: skip
    error_of_healthy = error_after(healthy, healthy)
    before, cost = distance(faulty, healthy), cost_of(faulty, conventional, error_of_healthy)

    def outcome(fixed: Case) -> str:
        rows = rows_of(fixed)
        if is_fixed(distance(rows, healthy), before):
            return "right"
        left = cost_of(rows, conventional, error_of_healthy)
        return "right" if cost is not None and left is not None and left < COSTLY <= cost else "wrong"

    faults = []
    for given in one.given:
        scored = _fault_score(given, one, findings)
        if scored.found and given.fault.fixable:
            first = serious(_about(given, one, findings))[0]
            fixed = _edited(one.case, first) if first.cures else None
            verdict = "none" if not first.cures else "wrong" if fixed is None else outcome(fixed)
            scored = replace(scored, first_fix=verdict)
        faults.append(scored)
    final = _after_all_fixes(one.case, findings)
    after = UNREADABLE if final is None else cost_of(rows_of(final), conventional, error_of_healthy)
    return replace(result, faults=tuple(faults), cost=cost, after=after)


def _inspected(case: Case) -> tuple[tuple[Finding, ...], str]:
    try:
        return inspect_log(case.log, case.rig).findings, ""
    except Exception:  # noqa: BLE001  # any exception counts as a failure
        return (), traceback.format_exc(limit=-3)


def _explained(finding: Finding, one: FaultCase) -> bool:
    """Whether one of the faults explains a finding."""
    places = [place for given in one.given for place in (*given.fault.places, *given.fault.consequences)]
    anything = bool(one.given) and finding.where in _ANYWHERE
    unpowered = finding.where == "controls" and not one.healthy.has("throttle")  # not recorded, so true
    return anything or unpowered or points_to(finding, places, one.case)


def _about(given: Given, one: FaultCase, findings: Sequence[Finding]) -> list[Finding]:
    return [f for f in findings if f.where in _ANYWHERE or points_to(f, given.fault.places, one.case)]


def _fault_score(given: Given, one: FaultCase, findings: Sequence[Finding]) -> FaultScore:
    about, fault = _about(given, one, findings), given.fault
    found = bool(serious(about))
    return FaultScore(fault.name, given.strength, fault.fixable, found, bool(about) and not found, "")


def _edited(case: Case, finding: Finding) -> Case | None:
    """The case with the first fix of a finding; None where that gives no valid rig."""
    try:
        return replace(case, rig=edited(case.rig, finding.cures[0]))
    except OffpisteError:
        return None


def _after_all_fixes(case: Case, findings: Sequence[Finding]) -> Case | None:
    """The case after the first fix of each finding was applied, repeatedly; None where `inspect` fails."""
    for _ in range(_ROUNDS):
        changed = case
        for finding in serious(findings):
            if finding.cures:
                changed = _edited(changed, finding) or changed
        if changed.rig == case.rig:
            break
        case = changed
        findings, error = _inspected(case)
        if error:
            return None
    return case
