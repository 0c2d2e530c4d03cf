"""Scores the checks of sensors on a case: found, first cure, other alarms."""

import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from experiments.illnesses.score import serious
from experiments.illnesses.sensors.case import SensorCase, case_of
from experiments.illnesses.sensors.declarations import SENSOR_ILLNESSES, SensorIllness
from experiments.illnesses.sensors.drives import SensorDrive, drive_of
from offpiste.core.errors import OffpisteError
from offpiste.inspection.findings import Finding, ranked
from offpiste.inspection.sensors import check_sensors
from offpiste.rig.edits import edited

CASES_PER_DRIVE: Final = 5
"""The first of them is healthy."""
_MAP: Final = ("LiDARs", "poses")
"""Places of notes that accuse: of ghosts, of what moves, of a drift in height."""


@dataclass(frozen=True)
class SensorPatient:
    """A case with its truth; `illness` is None for a healthy one."""

    seed: int
    drive: SensorDrive
    case: SensorCase
    illness: SensorIllness | None
    strength: float

    def __str__(self) -> str:
        return f"{self.illness.name} ({self.strength:g} {self.illness.unit})" if self.illness else "healthy"


@dataclass(frozen=True)
class SensorScore:
    """Result of one case.

    Attributes:
        illness: "" for a healthy case.
        found: whether a warning says what is wrong, and where.
        noted: whether only a note does.
        cure: "right", "wrong", "none" where the first warning about it has no cure, "" where it was not found or no
            entry of a rig can cure it.
        alarms: warnings and fatal findings that say something else.
        accusing: notes of the map that do.
        findings: all of them, in words.
        error: where the inspection failed: the exception.
        seconds: that it took.
    """

    seed: int
    behaviour: str
    layout: str
    illness: str
    unit: str
    strength: float
    found: bool
    noted: bool
    cure: str
    alarms: tuple[str, ...]
    accusing: tuple[str, ...]
    findings: tuple[str, ...]
    error: str
    seconds: float


def patient(seed: int, cache: Path, *, names: Sequence[str] = ()) -> SensorPatient:
    """The case of a seed.

    Args:
        cache: folder of simulated drives.
        names: illnesses to choose from; all by default.
    """
    drive = drive_of(seed // CASES_PER_DRIVE, cache)
    case, given = case_of(drive), given_to(seed, names)
    if given is None:
        return SensorPatient(seed, drive, case, None, 0.0)
    illness, strength = given
    sick = illness.change(case, strength, np.random.default_rng([seed, 0x5E5]))
    return SensorPatient(seed, drive, sick, illness, strength)


def given_to(seed: int, names: Sequence[str] = ()) -> tuple[SensorIllness, float] | None:
    """Illness and strength of a seed, None for a healthy one; they take turns, so that all are met equally often."""
    number, turn = divmod(seed, CASES_PER_DRIVE)
    if turn == 0:
        return None
    chosen = [SENSOR_ILLNESSES[name] for name in names] or [one for _, one in SENSOR_ILLNESSES.items()]
    choices = [(one, strength) for one in chosen for strength in one.strengths]
    # Shuffled, but always alike: the strengths of an illness are met in different drives.
    order = np.random.default_rng(0x5E5).permutation(len(choices))
    return choices[order[(number * (CASES_PER_DRIVE - 1) + turn - 1) % len(choices)]]


def score(one: SensorPatient) -> SensorScore:
    """Check the sensors of a case and compare the findings with its truth; channels have a score of their own."""
    started = time.perf_counter()
    findings: tuple[Finding, ...] = ()
    error = ""
    try:
        findings = ranked(check_sensors(one.case.log, one.case.rig))
    except Exception:  # noqa: BLE001  # whatever it is, it counts as a failure
        error = traceback.format_exc(limit=-3)
    ill = one.illness
    about = [finding for finding in findings if ill and is_about(finding, ill)]
    others = [f for f in findings if f not in about and not (ill and f.where in ill.consequences)]
    alarms = serious(others)
    return SensorScore(
        seed=one.seed,
        behaviour=one.drive.behaviour,
        layout=one.drive.layout,
        illness=ill.name if ill else "",
        unit=ill.unit if ill else "",
        strength=one.strength,
        found=bool(serious(about)),
        noted=bool(about) and not serious(about),
        cure=first_cure(one.case, ill, serious(about)) if ill else "",
        alarms=tuple(map(_words, alarms)),
        accusing=tuple(_words(f) for f in others if f.where in _MAP and f not in alarms),
        findings=tuple(map(_words, findings)),
        error=error,
        seconds=time.perf_counter() - started,
    )


def is_about(finding: Finding, illness: SensorIllness) -> bool:
    """Whether a finding says what is wrong, and where."""
    return finding.where == illness.where and illness.what in finding.what


def first_cure(case: SensorCase, illness: SensorIllness, warnings: Sequence[Finding]) -> str:
    """What became of the first cure of the first warning; see `SensorScore.cure`."""
    if illness.cured is None or not warnings:
        return ""
    if not warnings[0].cures:
        return "none"
    try:
        rig = edited(case.rig, warnings[0].cures[0])
    except OffpisteError:
        return "wrong"
    return "right" if illness.cured(case, rig) else "wrong"


def _words(finding: Finding) -> str:
    return f"{finding.severity}: {finding.where}: {finding.what} [{finding.evidence}] -> {finding.remedy}"
