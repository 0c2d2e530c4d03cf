"""Findings of `inspect` on the logs of a dataset, stored with each drive."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec

from offpiste.core.errors import LogError


class LogFinding(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A fatal finding or a warning of `inspect` on a log."""

    severity: Literal["fatal", "warning"]
    where: str  # channel or topic
    what: str
    evidence: str
    fix: str  # remedy in words

    @property
    def line(self) -> str:
        """The finding, its evidence and its remedy in one line."""
        return f"{self.where}: {self.what} ({self.evidence}); {self.fix}"


class StoredFindings(msgspec.Struct, frozen=True):
    """Attribute `findings` of a stored drive."""

    found: tuple[LogFinding, ...]
    schema: Literal[1] = 1


class UnusableLog(LogError):
    """A log with fatal `findings`: models would learn nothing from it, or nonsense."""

    def __init__(self, findings: Sequence[LogFinding], where: str | Path) -> None:
        self.findings = tuple(findings)
        worst = self.findings[0]
        more = f" (and {len(findings) - 1} more)" if len(findings) > 1 else ""
        super().__init__(
            f"unusable: {worst.where}: {worst.what}{more}",
            where=where,
            how=f"{worst.fix}; `offpiste inspect` shows details, --force extracts the log anyway",
        )

    def __reduce__(self) -> Any:
        return type(self), (self.findings, self.where)


def refuse_unusable(findings: Sequence[LogFinding], log: Path) -> None:
    """Raise `UnusableLog` if a finding is fatal."""
    if fatal := [finding for finding in findings if finding.severity == "fatal"]:
        raise UnusableLog(fatal, log)


def findings_by_drive(findings: Sequence[tuple[str, Sequence[LogFinding]]]) -> tuple[str, ...]:
    """Return each finding once, with the drives that have it, from names and findings of drives."""
    drives: dict[tuple[str, str], list[str]] = {}
    for name, found in findings:
        for finding in found:
            drives.setdefault((finding.where, finding.what), []).append(name)
    return tuple(
        f"{where} {what} (drive {first}{f' and {len(others)} more' if others else ''})"
        for (where, what), (first, *others) in drives.items()
    )


def warning_line(findings: Sequence[str]) -> str | None:
    """Summarise the findings of a dataset in one line; None without findings."""
    if not findings:
        return None
    more = f", and {len(findings) - 3} more" if len(findings) > 3 else ""
    count = f"{len(findings)} warning{'s' * (len(findings) > 1)}"
    named = "; ".join(findings[:3])
    return f"the dataset has {count} of `inspect`: {named}{more}; run `offpiste inspect` for details"
