"""Tables of many scores: faults found and fixed, false alarms, and costs after all fixes."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import binomtest

from experiments.inspection_faults.cost import COSTLY, UNREADABLE
from experiments.inspection_faults.score import FaultScore, Score
from offpiste.evaluation.intervals import MIN_UNITS


def share_table(measures: Mapping[str, Sequence[bool]]) -> str:
    """Return the share of hits of each measure as Markdown."""
    rows = (f"| {name} | {_share(hits)} |" for name, hits in measures.items())
    return "\n".join(("| measure | share (95 % interval) |", "|---|---|", *rows))


def _share(cases: Sequence[bool]) -> str:
    """Format a share with its interval."""
    hits, count = sum(cases), len(cases)
    if count == 0:
        return "-"
    low, high = binomtest(hits, count).proportion_ci(method="wilson")
    bounds = f"({low:.0%} to {high:.0%})" if count >= MIN_UNITS else f"(–: fewer than {MIN_UNITS} cases)"
    return f"{hits}/{count} = {hits / count:.0%} {bounds}"


def shown(cost: float | None) -> str:
    """Format a cost."""
    return "not known" if cost is None else "unreadable" if cost >= UNREADABLE else f"{cost:+.0%}"


def listed(title: str, lines: Sequence[str]) -> list[str]:
    """Return a section with a list, if there is anything to list."""
    return [f"## {title}", "\n".join(f"- {line}" for line in lines)] if lines else []


def report(scores: Sequence[Score]) -> str:
    """Return the whole report as Markdown."""
    healthy, faulty = [s for s in scores if not s.faults], [s for s in scores if s.faults]
    single = [(s, s.faults[0]) for s in faulty if len(s.faults) == 1]
    costly = [(s, fault) for s, fault in single if s.cost is not None and s.cost >= COSTLY]
    fixable = [fault for _, fault in costly if fault.fixable]
    after = [s.after for s in faulty if s.after is not None and all(fault.fixable for fault in s.faults)]
    several = [fault for s in faulty if len(s.faults) > 1 for fault in s.faults]
    measures = {
        "healthy logs with a false alarm": [bool(s.false_alarms) for s in healthy],
        "single faults that cost 5 % or more, found": [fault.found for _, fault in costly],
        "fixable ones among these, right first fix": [fault.first_fix == "right" for fault in fixable],
        "fixable logs within 5 % of healthy after all fixes": [cost < COSTLY for cost in after],
        "single faults of any cost, found": [fault.found for _, fault in single],
        "of several at once, found": [fault.found for fault in several],
        "faulty logs with a false alarm": [bool(s.false_alarms) for s in faulty],
        "failures of inspect": [bool(s.error) for s in scores],
    }
    parts = [
        "# What `inspect` finds in logs with known truth",
        f"{len(scores)} logs: {len(healthy)} healthy, {len(single)} with one fault, {len(faulty) - len(single)} with"
        " two or three. Intervals are Wilson's 95 %.",
        share_table(measures),
        *_by_fault(single),
        *listed("False alarms on healthy logs", [_line(s, alarm) for s in healthy for alarm in s.false_alarms]),
        *listed("False alarms on faulty logs", [_line(s, alarm) for s in faulty for alarm in s.false_alarms]),
        *listed("Faults not found that cost at least 5 %", [_line(s, _named(f)) for s, f in costly if not f.found]),
        *listed("Wrong first fixes", [_line(s, _named(f)) for s, f in single if f.first_fix == "wrong"]),
        *listed("Failures of inspect", [_line(s, s.error.strip().splitlines()[-1]) for s in scores if s.error]),
    ]
    return "\n\n".join(parts) + "\n"


def _by_fault(single: Sequence[tuple[Score, FaultScore]]) -> list[str]:
    """Return a row for each fault and strength; costs are medians."""
    lines = ["| fault | strength | logs | cost | found | noted | right first fix | cost after fixes |",
             "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for name, strength in sorted({(fault.name, fault.strength) for _, fault in single}):
        rows = [(s, fault) for s, fault in single if (fault.name, fault.strength) == (name, strength)]
        faults = [fault for _, fault in rows]
        found, noted = sum(fault.found for fault in faults), sum(fault.noted for fault in faults)
        right = f"{sum(fault.first_fix == 'right' for fault in faults)}/{len(rows)}" if faults[0].fixable else ""
        cost, after = _median([s.cost for s, _ in rows]), _median([s.after for s, _ in rows])
        found_of = f"{found}/{len(rows)}"
        lines.append(f"| {name} | {strength:g} | {len(rows)} | {cost} | {found_of} | {noted} | {right} | {after} |")
    return ["## Single faults", "\n".join(lines)] if single else []


def _median(costs: Sequence[float | None]) -> str:
    known = [cost for cost in costs if cost is not None]
    return shown(float(np.median(known)) if known else None)


def _line(score: Score, text: str) -> str:
    return f"{score.seed} ({score.drive}; cost {shown(score.cost)}): {text}"


def _named(fault: FaultScore) -> str:
    return f"{fault.name} ({fault.strength:g})"
