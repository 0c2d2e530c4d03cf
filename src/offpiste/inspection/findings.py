"""Findings: what an inspection reports about a log, and how to fix it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from offpiste.rig.edits import Edit

Severity = Literal["fatal", "warning", "note"]
EXCHANGED = "latitude and longitude are exchanged"
"""What is wrong with places that the rig reads in the wrong order."""
TIPPED = "climbs as much as it drives"
"""What is found of a position whose z is not up."""

Cure = tuple[Edit, ...]
"""Rig edits that are made together."""
_NAMED = 4
"""Fields that a finding on many of them names."""
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
        cures: rig edits that may fix it, the likeliest first; `remedies` applies and checks them.
        sure: whether it is wrong whatever else is; otherwise it is a warning only if one of its cures proves right.
        also: other findings of the same cause, which the same cure silences.
    """

    severity: Severity
    where: str
    what: str
    evidence: str
    remedy: str
    score: float = 0.0
    cures: tuple[Cure, ...] = ()
    sure: bool = True
    also: tuple[str, ...] = ()


def ranked(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Findings in order, the worst first."""
    return tuple(sorted(findings, key=lambda f: (_ORDER[f.severity], -f.score, f.where, f.what)))


def is_fatal(findings: Iterable[Finding]) -> bool:
    """Whether one of the findings makes a log unusable."""
    return any(finding.severity == "fatal" for finding in findings)


def merged(findings: list[Finding]) -> list[Finding]:
    """Notes that say the same of several topics become one."""
    together: dict[tuple[str, str], list[Finding]] = {}
    for finding in findings:
        key = (finding.what, finding.remedy) if finding.severity == "note" else (finding.where, finding.what)
        together.setdefault(key, []).append(finding)
    return [
        group[0]
        if len(group) == 1
        else replace(
            group[0],
            where=", ".join(f.where for f in group),
            evidence="; ".join(f"{f.where} {f.evidence}" for f in group),
            score=max(f.score for f in group),
        )
        for group in together.values()
    ]


def of_one_cause(findings: list[Finding]) -> list[Finding]:
    """Findings that name the same samples become one, as of a motion capture that loses the vehicle."""
    together: dict[tuple[str, ...], list[Finding]] = {}
    for finding in findings:
        together.setdefault((finding.severity, finding.evidence, finding.remedy), []).append(finding)
    return [_as_one(group) if len(group) > 1 else group[0] for group in together.values()]


def _as_one(findings: Sequence[Finding]) -> Finding:
    if findings[0].severity == "note":  # of fields that no channel reads
        more = f" and {len(findings) - _NAMED} more" if len(findings) > _NAMED else ""
        return replace(findings[0], where=", ".join(finding.where for finding in findings[:_NAMED]) + more)
    channels, places = zip(*(finding.where.removesuffix(")").split(" (", 1) for finding in findings), strict=True)
    evidence = f"{findings[0].evidence}, alike in {', '.join(places)}"
    return replace(findings[0], where=", ".join(dict.fromkeys(channels)), evidence=evidence)
