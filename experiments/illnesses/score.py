"""Scores `inspect` on a case: found, cured, false alarms, and what is left after all cures."""

import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from experiments.illnesses.cases import Given, Patient
from experiments.illnesses.effect import MANY, UNREADABLE, Costs, Readable, costs_against, distance, is_cured, rows_of
from experiments.illnesses.recording import Case
from offpiste.core.errors import OffpisteError
from offpiste.inspection.findings import Finding
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.log import Log
from offpiste.rig.edits import Edit, edited

_ROUNDS: Final = 5
COSTLY: Final = 0.05
"""Cost from which on an illness matters: 5 % of the error after five seconds."""
_ANYWHERE: Final = ("log", "table")
"""Places of a finding that speak of the whole recording."""


@dataclass(frozen=True)
class IllnessScore:
    """What became of one illness.

    Attributes:
        found: whether a warning, or a fatal finding, points to one of its places.
        noted: whether a note does.
        first_cure: "right", "wrong", "none" where the first finding about it has no cure, "" where it was not found or
            nothing can cure it.
    """

    name: str
    strength: float
    kind: str
    curable: bool
    found: bool
    noted: bool
    first_cure: str


@dataclass(frozen=True)
class Score:
    """Result of one case.

    Attributes:
        body, behaviour: in words.
        illnesses: none for a healthy case.
        harmless: changes that are no illness.
        cost: error of the quick model with the illnesses, over the healthy log's, minus 1; None where the healthy log
            has too few windows (`effect.Costs`).
        after: the same after all cures.
        own_cost, own_after: both by many windows, and in the log's own conventions: the last part of the healthy log is
            read by what is a convention only (`Illness.convention`), as the vehicle would be driven.
        distance: from the healthy rows, by `effect.distance`.
        false_alarms: warnings and fatal findings that point elsewhere.
        findings: all of them, in words.
        error: where `inspect` failed: the exception.
        seconds: that `inspect` took.
    """

    seed: int
    body: str
    behaviour: str
    storage: str
    illnesses: tuple[IllnessScore, ...]
    harmless: tuple[str, ...]
    cost: float | None
    after: float | None
    distance: float
    false_alarms: tuple[str, ...]
    findings: tuple[str, ...]
    error: str = ""
    seconds: float = field(default=0.0)
    own_cost: float | None = None
    own_after: float | None = None


def serious(findings: Sequence[Finding]) -> list[Finding]:
    """Warnings and fatal findings."""
    return [finding for finding in findings if finding.severity != "note"]


def points_to(finding: Finding, channels: Sequence[str], case: Case) -> bool:
    """Whether a finding points to one of these channels, or a topic of one: by its place, its cause or its cure."""
    topics = {case.source(channel).topic or "table" for channel in channels if case.has(channel)}
    named = {part.split(" ")[0] for place in (finding.where, *finding.also) for part in place.split(", ")}
    cured = {edit.key.split(".")[1] for cure in finding.cures[:1] for edit in cure if edit.key.startswith("channels.")}
    return bool((named | cured) & {*channels, *topics})


def score(patient: Patient, log: Log, *, storage: str) -> Score:
    """Inspect a case and compare the findings with its truth.

    Args:
        log: the case's recording, in memory or from a file.
        storage: where it is from, in words.
    """
    started = time.perf_counter()
    error = ""
    findings: tuple[Finding, ...] = ()
    try:
        findings = inspect_log(log, patient.case.rig).findings
    except Exception:  # noqa: BLE001  # whatever it is, it counts as a failure
        error = traceback.format_exc(limit=-3)
    seconds = time.perf_counter() - started

    drive = patient.drive
    result = Score(
        seed=patient.seed,
        body=f"wheelbase {drive.wheelbase:.2f} m, {drive.seconds:.0f} s",
        behaviour=drive.behaviour,
        storage=storage,
        illnesses=(),
        harmless=tuple(str(given) for given in patient.given if given.illness.kind == "healthy"),
        cost=0.0,
        after=0.0,
        own_cost=0.0,
        own_after=0.0,
        distance=0.0,
        false_alarms=tuple(_words(f) for f in serious(findings) if not _explained(f, patient)),
        findings=tuple(_words(f) for f in findings),
        error=error,
        seconds=seconds,
    )
    return _with_effects(result, patient, findings)


def _with_effects(result: Score, patient: Patient, findings: Sequence[Finding]) -> Score:
    """The score with costs and cures."""
    needs_healthy = patient.illnesses or any(finding.cures for finding in serious(findings))
    healthy = rows_of(patient.healthy) if needs_healthy else None
    if healthy is None:
        ill = tuple(_illness_score(given, patient, findings, None, 0.0, None) for given in patient.illnesses)
        return replace(result, illnesses=ill)
    costs, own = costs_against(healthy), costs_against(healthy, rows_of(patient.conventional), windows=MANY)
    sick = rows_of(patient.case)
    away, cost, own_cost = distance(sick, healthy), costs.of_rows(sick), own.of_rows(sick)
    cured = _after_all(patient.case, findings)
    changed = cured is not None and cured.rig != patient.case.rig
    return replace(
        result,
        illnesses=tuple(_illness_score(given, patient, findings, healthy, away, costs) for given in patient.illnesses),
        cost=cost,
        after=UNREADABLE if cured is None else costs.of(cured) if changed else cost,
        own_cost=own_cost,
        own_after=UNREADABLE if cured is None else own.of(cured) if changed else own_cost,
        distance=away,
    )


def _explained(finding: Finding, patient: Patient) -> bool:
    """Whether one of the illnesses explains a finding."""
    places = [place for g in patient.illnesses for place in (*g.illness.places, *g.illness.consequences)]
    anything = bool(patient.illnesses) and finding.where in _ANYWHERE
    unpowered = finding.where == "controls" and not patient.healthy.has("throttle")  # by the logger, and true
    return anything or unpowered or points_to(finding, places, patient.case)


def _illness_score(
    given: Given,
    patient: Patient,
    findings: Sequence[Finding],
    healthy: Readable | None,
    away: float,
    costs: Costs | None,
) -> IllnessScore:
    ill = given.illness
    about = [f for f in findings if points_to(f, ill.places, patient.case) or f.where in _ANYWHERE]
    strong = serious(about)
    cure = ""
    if ill.curable and strong and healthy is not None and costs is not None:
        cure = _first_cure(patient, strong[0], healthy, away, costs)
    noted = len(strong) < len(about)
    return IllnessScore(ill.name, given.strength, ill.kind, ill.curable, bool(strong), noted, cure)


def _first_cure(patient: Patient, finding: Finding, healthy: Readable, away: float, costs: Costs) -> str:
    """Whether the first cure brings the rows back, or takes all of a cost that mattered."""
    if not finding.cures:
        return "none"
    cured = _edited(patient.case, finding.cures[0])
    if cured is None:
        return "wrong"
    if is_cured(distance(rows_of(cured), healthy), away):
        return "right"
    cost, left = costs.of(patient.case), costs.of(cured)
    return "right" if cost is not None and left is not None and left < COSTLY <= cost else "wrong"


def _edited(case: Case, edits: Sequence[Edit]) -> Case | None:
    """The case with an edited rig; None where that is no rig."""
    try:
        return replace(case, rig=edited(case.rig, edits))
    except OffpisteError:
        return None


def _after_all(case: Case, findings: Sequence[Finding]) -> Case | None:
    """The case after the first cure of each finding was applied, again and again; None where `inspect` fails."""
    for _ in range(_ROUNDS):
        changed = case
        for finding in serious(findings):
            if finding.cures:
                changed = _edited(changed, finding.cures[0]) or changed
        if changed.rig == case.rig:
            break
        case = changed
        try:
            findings = inspect_log(case.log, case.rig).findings
        except Exception:  # noqa: BLE001  # as above
            return None
    return case


def _words(finding: Finding) -> str:
    return f"{finding.severity}: {finding.where}: {finding.what} [{finding.evidence}] -> {finding.remedy}"
