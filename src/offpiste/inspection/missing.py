"""Check of the rig's channels for topics and fields that the log does not have."""

from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from typing import Final

from offpiste.inspection.findings import Finding
from offpiste.inspection.recorded_log import Recorded
from offpiste.rig.channels import ChannelSource
from offpiste.rig.edits import Edit, absent
from offpiste.rig.rig import Rig

_NEEDED: Final = ("position", "orientation", "yaw")
"""Channels that no log is usable without: they are not declared absent."""
_LISTED: Final = 12


def check_missing(recorded: dict[str, Recorded], rig: Rig) -> list[Finding]:
    """Findings on channels whose topic or fields are not in the log, with names that are nearly the same."""
    findings = []
    for name, source in rig.channels.items():
        r = recorded.get(source.topic)
        missing = [] if r is None else [field for field in source.fields if field not in r.fields]
        if r is not None and not missing:
            continue
        if r is None:
            what, there = f"its topic '{source.topic}' is not in the log, or holds no numbers", list(recorded)
        else:
            what, there = f"its topic has no field '{missing[0]}'", list(map(r.topic.in_words, r.fields))
        cures = tuple(_cures(name, source, recorded, rig))
        evidence = "there is: " + ", ".join(there[:_LISTED]) + (", ..." if len(there) > _LISTED else "")
        remedy = ", ".join(map(str, cures[0])) if cures else f"name where it is recorded in [channels.{name}]"
        findings.append(Finding("fatal", name, what, evidence, remedy, 1.0, cures))
    return findings


def _cures(name: str, source: ChannelSource, recorded: dict[str, Recorded], rig: Rig) -> Iterator[tuple[Edit, ...]]:
    """Names that are nearly the same, and the channel's absence."""
    for topic in [source.topic] if source.topic in recorded else get_close_matches(source.topic, recorded, 3):
        there = recorded[topic]
        by_joint = {joint: field for field, joint in there.topic.joints.items()}
        fields = [by_joint.get(field, field) for field in source.fields]
        if not set(fields) <= set(there.fields):
            fields = _renamed(source.fields, there.fields)
        if fields:
            edits = (("topic", topic, source.topic), ("fields", fields, list(source.fields)))
            yield tuple(Edit(f"channels.{name}.{key}", new) for key, new, old in edits if new != old)
    if name not in _NEEDED:
        yield absent(name, rig)


def _renamed(fields: Sequence[str], there: Sequence[str]) -> list[str]:
    """The nearest name of each field, where all have one and no two the same; empty otherwise."""
    nearest = [f if f in there else next(iter(get_close_matches(f, there, 1)), "") for f in fields]
    return nearest if all(nearest) and len(set(nearest)) == len(nearest) else []
