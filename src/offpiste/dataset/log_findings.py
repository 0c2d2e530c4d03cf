"""What `inspect` finds on the logs of a dataset: before extraction, in the store, and in one line for models."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Literal

import msgspec

from offpiste.core.errors import DatasetError, LogError
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.log import Log
from offpiste.rig.rig import Rig

FINDINGS_SCHEMA: Final = 1
"""Version of the attribute `findings` of a drive."""
_NAMED: Final = 3
"""Findings that one line names."""


class LogFinding(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A fatal finding or a warning of `inspect` on a log, as a dataset keeps it (`inspection.findings.Finding`).

    Attributes:
        fix: how to fix it.
    """

    severity: Literal["fatal", "warning"]
    where: str
    what: str
    evidence: str
    fix: str

    @property
    def line(self) -> str:
        """What, where and how to fix it."""
        return f"{self.where}: {self.what} ({self.evidence}); {self.fix}"


class _Stored(msgspec.Struct, frozen=True):
    schema: int
    found: tuple[LogFinding, ...]


class UnusableLog(LogError):
    """A log of which `inspect` finds that models would learn nothing or nonsense from it.

    Args:
        findings: the fatal ones.
    """

    def __init__(self, findings: Sequence[LogFinding], where: str | Path) -> None:
        self.findings = tuple(findings)
        worst = self.findings[0]
        more = f" (and {len(findings) - 1} more)" if len(findings) > 1 else ""
        super().__init__(
            f"unusable: {worst.where}: {worst.what}{more}",
            where=where,
            how=f"{worst.fix}; `offpiste inspect` says more, --force extracts it anyway",
        )

    def __reduce__(self) -> Any:
        return type(self), (self.findings, self.where)


def findings_on(log: Log, rig: Rig) -> tuple[LogFinding, ...]:
    """Fatal findings and warnings on the channels of a log; cameras and LiDARs are left to `offpiste inspect`."""
    found = inspect_log(log, rig).findings
    return tuple(LogFinding(f.severity, f.where, f.what, f.evidence, f.remedy) for f in found if f.severity != "note")


def refuse_unusable(findings: Sequence[LogFinding], log: Path) -> None:
    """Raise if a finding is fatal.

    Raises:
        UnusableLog: names the log, the worst finding and its fix.
    """
    fatal = [finding for finding in findings if finding.severity == "fatal"]
    if fatal:
        raise UnusableLog(fatal, log)


def stored_findings(findings: Sequence[LogFinding]) -> dict[str, Any]:
    """Findings as the attributes of a drive keep them."""
    result: dict[str, Any] = msgspec.to_builtins(_Stored(FINDINGS_SCHEMA, tuple(findings)))
    return result


def read_findings(attribute: object, where: Path) -> tuple[LogFinding, ...]:
    """Findings from the attribute of a drive; none of drives that were extracted before there was one.

    Raises:
        DatasetError: of another version, or not findings.
    """
    if attribute is None:
        return ()
    try:
        stored = msgspec.convert(attribute, type=_Stored)
    except msgspec.ValidationError as error:
        raise _unreadable(where, f"findings cannot be read ({error})") from error
    if stored.schema != FINDINGS_SCHEMA:
        raise _unreadable(where, f"findings of schema {stored.schema}, this offpiste reads {FINDINGS_SCHEMA}")
    return stored.found


def _unreadable(where: Path, what: str) -> DatasetError:
    return DatasetError(what, where=where, how=f"delete {where} and run `offpiste extract` again")


def findings_by_drive(findings: Sequence[tuple[str, Sequence[LogFinding]]]) -> tuple[str, ...]:
    """Each finding on the drives of a dataset once, with the drives that have it.

    Args:
        findings: for each drive, its name and its findings.
    """
    drives: dict[tuple[str, str], list[str]] = {}
    for name, found in findings:
        for finding in found:
            drives.setdefault((finding.where, finding.what), []).append(name)
    return tuple(f"{where} {what} ({_some(names)})" for (where, what), names in drives.items())


def warning_line(findings: Sequence[str]) -> str | None:
    """What `findings_by_drive` gives, in one line; None where there is nothing to warn of."""
    if not findings:
        return None
    more = f", and {len(findings) - _NAMED} more" if len(findings) > _NAMED else ""
    count = f"{len(findings)} warning{'s' * (len(findings) > 1)}"
    return f"the dataset has {count} of `inspect`: {'; '.join(findings[:_NAMED])}{more}; `offpiste inspect` says more"


def _some(drives: Sequence[str]) -> str:
    named = [f"drive {name}" for name in drives[:1]]
    return named[0] if len(drives) == 1 else f"{named[0]} and {len(drives) - 1} more"
