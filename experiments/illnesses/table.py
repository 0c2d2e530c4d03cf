"""Tables of many scores: what is found and cured at which strength, false alarms, and what is left after cures."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.illnesses.effect import UNREADABLE
from experiments.illnesses.score import COSTLY, IllnessScore, Score
from offpiste.evaluation.intervals import MIN_UNITS, share_interval


@dataclass(frozen=True)
class Row:
    """A score of one illness, with the case that it is from; only cases with a single illness."""

    score: Score
    ill: IllnessScore


def share(hits: int, count: int) -> str:
    """A share with its interval, in words."""
    if count == 0:
        return "-"
    low, high = share_interval(hits, count)
    bounds = f"({low:.0%} to {high:.0%})" if count >= MIN_UNITS else f"(–: fewer than {MIN_UNITS} cases)"
    return f"{hits}/{count} = {hits / count:.0%} {bounds}"


def report(scores: Sequence[Score]) -> str:
    """The whole report as Markdown."""
    healthy = [s for s in scores if not s.illnesses]
    sick = [s for s in scores if s.illnesses]
    single = [Row(s, s.illnesses[0]) for s in sick if len(s.illnesses) == 1]
    parts = [
        "# What `inspect` finds in logs with known truth",
        f"{len(scores)} logs: {len(healthy)} healthy, {len(single)} with one illness, {len(sick) - len(single)} with"
        " two or three. Intervals are Wilson's 95 %.",
        _totals(healthy, sick, single),
        *_table_of(single),
        *_behaviours(healthy),
        *_listed("False alarms on healthy logs", [(s, f) for s in healthy for f in s.false_alarms]),
        *_listed("False alarms on sick logs", [(s, f) for s in sick for f in s.false_alarms]),
        *_listed("Illnesses not found, that cost at least 5 %", _missed(single)),
        *_listed("Wrong first cures", [(r.score, _finding_of(r)) for r in single if r.ill.first_cure == "wrong"]),
        *_listed("Failures of inspect", [(s, s.error.strip().splitlines()[-1]) for s in scores if s.error]),
    ]
    return "\n\n".join(parts) + "\n"


def _totals(healthy: Sequence[Score], sick: Sequence[Score], single: Sequence[Row]) -> str:
    costly, own = ([r for r in single if costs(r.score, own=own)] for own in (False, True))
    curable = [s for s in sick if all(i.curable for i in s.illnesses)]
    after = [s.after for s in curable if s.after is not None]
    own_after = [s.own_after for s in curable if s.own_after is not None]
    several = [(s, i) for s in sick if len(s.illnesses) > 1 for i in s.illnesses]
    lines = [
        "| measure | share (95 % interval) |",
        "|---|---|",
        f"| healthy logs with a false alarm | {share(sum(bool(s.false_alarms) for s in healthy), len(healthy))} |",
        f"| single illnesses that cost 5 % or more, found | {_found(costly)} |",
        f"| the same in their own conventions, by many windows | {_found(own)} |",
        f"| single illnesses of any cost, found | {share(sum(r.ill.found for r in single), len(single))} |",
        f"| of costly and curable ones, right first cure | {_right_of(costly)} |",
        f"| the same in their own conventions, by many windows | {_right_of(own)} |",
        f"| of several at once, found | {share(sum(i.found for _, i in several), len(several))} |",
        f"| sick logs with a false alarm | {share(sum(bool(s.false_alarms) for s in sick), len(sick))} |",
        f"| curable logs within 5 % of healthy after all cures | {_well(after)} |",
        f"| the same in their own conventions, by many windows | {_well(own_after)} |",
        f"| failures of inspect | {share(sum(bool(s.error) for s in (*healthy, *sick)), len(healthy) + len(sick))} |",
    ]
    return "\n".join(lines)


def _found(rows: Sequence[Row]) -> str:
    return share(sum(row.ill.found for row in rows), len(rows))


def _right_of(rows: Sequence[Row]) -> str:
    curable = [row for row in rows if row.ill.curable]
    return share(_right(curable), len(curable))


def _well(after: Sequence[float]) -> str:
    return share(sum(cost < COSTLY for cost in after), len(after))


def _right(rows: Sequence[Row]) -> int:
    return sum(row.ill.first_cure == "right" for row in rows)


def _table_of(single: Sequence[Row]) -> list[str]:
    keys = sorted({(r.ill.kind, r.ill.name, r.ill.strength) for r in single})
    lines = [
        "## By illness and strength",
        "Cost: median increase of a quick model's error after 5 s. Logs with a single illness. Cured: the first cure of"
        " the first finding brings the rows back; after: median cost after all cures.",
        "\n".join(
            [
                "| kind | illness | strength | logs | cost | found | noted | cured | after | other alarms |",
                "|---|---|---|---|---|---|---|---|---|---|",
                *(_line(key, [r for r in single if (r.ill.kind, r.ill.name, r.ill.strength) == key]) for key in keys),
            ]
        ),
    ]
    return lines if single else []


def _line(key: tuple[str, str, float], rows: Sequence[Row]) -> str:
    kind, name, strength = key
    cost, after = _percent([r.score.cost for r in rows]), _percent([r.score.after for r in rows])
    cured = f"{_right(rows)}/{len(rows)}" if rows[0].ill.curable else ""
    found, noted = sum(r.ill.found for r in rows), sum(r.ill.noted and not r.ill.found for r in rows)
    alarms = sum(bool(r.score.false_alarms) for r in rows)
    return (
        f"| {kind} | {name} | {strength:g} | {len(rows)} | {cost} | {found}/{len(rows)} | {noted} | {cured} | {after} |"
        f" {alarms} |"
    )


def shown(cost: float | None) -> str:
    """A cost in words."""
    return "not known" if cost is None else "unreadable" if cost >= UNREADABLE else f"{cost:+.0%}"


def _percent(values: Sequence[float | None]) -> str:
    """Median of costs."""
    known = [value for value in values if value is not None]
    return shown(float(np.median(known)) if known else None)


def costs(score: Score, *, own: bool = False) -> bool:
    """Whether an illness costs 5 % or more: in the log's own conventions, by many windows, or as ever."""
    cost = score.own_cost if own else score.cost
    return cost is not None and cost >= COSTLY


def _behaviours(healthy: Sequence[Score]) -> list[str]:
    kinds = sorted({s.behaviour for s in healthy} | {h for s in healthy for h in s.harmless})
    lines = ["| healthy behaviour or harmless change | logs with a false alarm |", "|---|---|"]
    for kind in kinds:
        rows = [s for s in healthy if s.behaviour == kind or kind in s.harmless]
        lines.append(f"| {kind} | {share(sum(bool(s.false_alarms) for s in rows), len(rows))} |")
    return ["## Healthy logs", "\n".join(lines)] if healthy else []


def _missed(single: Sequence[Row]) -> list[tuple[Score, str]]:
    return [
        (r.score, f"{r.ill.name} ({r.ill.strength:g}), cost {shown(r.score.cost)}, own {shown(r.score.own_cost)}")
        for r in single
        if not r.ill.found and (costs(r.score) or costs(r.score, own=True))
    ]


def _finding_of(row: Row) -> str:
    about = [f for f in row.score.findings if not f.startswith("note")]
    return f"{row.ill.name} ({row.ill.strength:g}): {about[0] if about else ''}"


def _listed(title: str, entries: Sequence[tuple[Score, str]]) -> list[str]:
    if not entries:
        return []
    lines = [f"- {s.seed} ({s.behaviour}, {s.storage}): {text}" for s, text in sorted(entries, key=lambda e: e[1])]
    return [f"## {title}", "\n".join(lines)]
