"""Findings: problems that an inspection reports about a log, and their fixes."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import Any, Final, Literal

from offpiste.core.errors import OffpisteError
from offpiste.core.limits import packaged_table
from offpiste.rig.edits import Edit

Severity = Literal["fatal", "warning", "note"]

Cure = tuple[Edit, ...]
"""Rig edits applied together."""
MESSAGES: Final = packaged_table("offpiste.inspection", "messages.toml")
"""Descriptions, evidence and remedies of findings, by code (see messages.toml)."""
_NAMED = 4
"""Maximum number of fields named by a finding."""
_ORDER: dict[Severity, int] = {"fatal": 0, "warning": 1, "note": 2}


@dataclass(frozen=True)
class Finding:
    """A problem of a log: its location, evidence and fix.

    Attributes:
        severity: "fatal": unusable for training; "warning": degrades training; "note": for information.
        where: topic, field or channel.
        what: description without a full stop.
        evidence: supporting numbers with units.
        remedy: the exact rig line, or advice if no rig line helps.
        score: affected share of the drive, 0 to 1; ranks findings of equal severity.
        cures: candidate fixes as rig edits, most likely first; `remedies` applies and checks them.
        sure: True if independent of other findings; otherwise it is a warning only if one of its fixes is confirmed.
        also: other findings of the same cause, removed by the same fix.
        code: name of the message (messages.toml).
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
    code: str = ""


def found(
    code: str,
    where: str,
    values: Mapping[str, Any],
    *cures: Cure,
    severity: Severity | None = None,
    score: float | None = None,
    remedy: str = "remedy",
    fixed: str = "fixed",
    sure: bool = True,
) -> Finding:
    """Return a finding in the words of messages.toml.

    Args:
        code: name of the message.
        where: topic, field or channel.
        values: values of its placeholders, besides `where`, `score` and `fix`, the first fix.
        cures: candidate fixes, most likely first; empty ones are dropped.
        severity, score: override the message's.
        remedy, fixed: which of the message's remedies to take without and with a fix.
        sure: see `Finding`.
    """
    message, known = MESSAGES[code], tuple(cure for cure in cures if cure)
    score = message.get("score", 1.0) if score is None else score
    advice = message.get(fixed, "{fix}") if known else message.get(remedy, "")
    values = {"where": where, **values, "score": score, "fix": ", ".join(map(str, known[0])) if known else ""}
    what, evidence, how = (text.format(**values) for text in (message["what"], message["evidence"], advice))
    by_score: Severity = "warning" if score > message.get("warning_above", inf) else "note"
    return Finding(
        severity or message.get("severity", by_score), where, what, evidence, how, score, known, sure, code=code
    )


def unreadable(
    where: str,
    error: OffpisteError,
    when: str = "on reading it",
    *,
    severity: Severity = "fatal",
    code: str = "unreadable",
) -> Finding:
    """Return a finding that states an error."""
    return found(code, where, {"what": error.what, "when": when, "how": error.how}, severity=severity)


def times(count: int) -> str:
    """Return how often something happened, in words."""
    return "once" if count == 1 else f"{count} times"


def ranked(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings sorted by severity, worst first."""
    return tuple(sorted(findings, key=lambda f: (_ORDER[f.severity], -f.score, f.where, f.what)))


def is_fatal(findings: Iterable[Finding]) -> bool:
    """Return True if a finding makes a log unusable."""
    return any(finding.severity == "fatal" for finding in findings)


def merged(findings: list[Finding]) -> list[Finding]:
    """Merge equal notes on several topics."""
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
    """Merge findings on the same samples, e.g. of a motion capture that loses the vehicle."""
    together: dict[tuple[str, ...], list[Finding]] = {}
    for finding in findings:
        together.setdefault((finding.severity, finding.evidence, finding.remedy), []).append(finding)
    return [_as_one(group) if len(group) > 1 else group[0] for group in together.values()]


def _as_one(findings: Sequence[Finding]) -> Finding:
    if findings[0].severity == "note":  # unused fields
        more = f" and {len(findings) - _NAMED} more" if len(findings) > _NAMED else ""
        return replace(findings[0], where=", ".join(finding.where for finding in findings[:_NAMED]) + more)
    channels, places = zip(*(finding.where.removesuffix(")").split(" (", 1) for finding in findings), strict=True)
    evidence = f"{findings[0].evidence}, alike in {', '.join(places)}"
    return replace(findings[0], where=", ".join(dict.fromkeys(channels)), evidence=evidence)
