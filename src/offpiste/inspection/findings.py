"""Findings: what an inspection reports about a log, and how to fix it."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Severity = Literal["fatal", "warning", "note"]
_ORDER: dict[Severity, int] = {"fatal": 0, "warning": 1, "note": 2}


@dataclass(frozen=True)
class Finding:
    """What is wrong, where, how it was seen, and how to fix it.

    Attributes:
        severity: "fatal": not usable for training; "warning": training would be worse or wrong; "note": good to know.
        where: topic, field or channel.
        what: in words, without a full stop.
        evidence: the numbers it rests on, with units.
        remedy: the exact rig line, or what to do where no rig line helps.
        score: share of the drive that is affected, 0 to 1; ranks findings of one severity.
    """

    severity: Severity
    where: str
    what: str
    evidence: str
    remedy: str
    score: float = 0.0


def ranked(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Findings in order, the worst first."""
    return tuple(sorted(findings, key=lambda f: (_ORDER[f.severity], -f.score, f.where, f.what)))


def is_fatal(findings: Iterable[Finding]) -> bool:
    """Whether one of the findings makes a log unusable."""
    return any(finding.severity == "fatal" for finding in findings)


def number(value: float) -> str:
    """A number as a rig line takes it: four digits, always a float."""
    text = f"{value:.4g}"
    return text if any(c in text for c in ".en") else f"{text}.0"
