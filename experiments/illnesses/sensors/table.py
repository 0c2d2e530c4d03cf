"""Tables of many scores of sensors: what is found and cured at which strength, and false alarms."""

from collections.abc import Sequence

from experiments.illnesses.sensors.declarations import SENSOR_ILLNESSES
from experiments.illnesses.sensors.score import CASES_PER_DRIVE, SensorScore
from experiments.illnesses.table import share


def report(scores: Sequence[SensorScore]) -> str:
    """The whole report as Markdown."""
    healthy = [s for s in scores if not s.illness]
    sick = [s for s in scores if s.illness]
    parts = [
        "# What `inspect` finds in cameras and LiDARs of logs with known truth",
        f"{len(scores)} logs of {len({s.seed // CASES_PER_DRIVE for s in scores})} drives: {len(healthy)} healthy,"
        f" {len(sick)} with one illness. Intervals are Wilson's 95 %.",
        _totals(healthy, sick),
        "## By illness and strength",
        "\n".join([
            "| illness | strength | logs | found | noted | right first cure | logs with another alarm |",
            "|---|---|---|---|---|---|---|",
            *_rows(sick),
        ]),
        *_listed("False alarms on healthy logs", [(s, a) for s in healthy for a in (*s.alarms, *s.accusing)]),
        *_listed("Other alarms on sick logs", [(s, a) for s in sick for a in s.alarms]),
        *_listed("Not found and not noted", [(s, _name(s)) for s in sick if not (s.found or s.noted)]),
        *_listed("Wrong first cures", [(s, _name(s)) for s in sick if s.cure == "wrong"]),
        *_listed("Failures of inspect", [(s, s.error.strip().splitlines()[-1]) for s in scores if s.error]),
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


def _totals(healthy: Sequence[SensorScore], sick: Sequence[SensorScore]) -> str:
    curable = [s for s in sick if s.found and SENSOR_ILLNESSES[s.illness].cured]
    lines = [
        "| measure | share (95 % interval) |",
        "|---|---|",
        f"| healthy logs with a false alarm | {share(sum(bool(s.alarms) for s in healthy), len(healthy))} |",
        f"| healthy logs with an accusing note | {share(sum(bool(s.accusing) for s in healthy), len(healthy))} |",
        f"| illnesses found or noted | {share(sum(s.found or s.noted for s in sick), len(sick))} |",
        f"| of found and curable ones, right first cure | {share(_right(curable), len(curable))} |",
        f"| sick logs with another alarm | {share(sum(bool(s.alarms) for s in sick), len(sick))} |",
        f"| failures of inspect | {share(sum(bool(s.error) for s in (*healthy, *sick)), len(healthy) + len(sick))} |",
    ]
    return "\n".join(lines)


def _rows(sick: Sequence[SensorScore]) -> list[str]:
    """A row for each illness and strength, and one with its interval for each illness."""
    lines = []
    for name, one in SENSOR_ILLNESSES.items():
        of_name = [s for s in sick if s.illness == name]
        for strength in one.strengths:
            rows = [s for s in of_name if s.strength == strength]
            if rows:
                found = f"{sum(s.found for s in rows)}/{len(rows)}"
                lines.append(_row(name, f"{strength:g} {one.unit}", rows, found))
        if of_name and len(one.strengths) > 1:
            found = share(sum(s.found or s.noted for s in of_name), len(of_name)) + ", notes among them"
            lines.append(_row(f"**{name}**", "all", of_name, found))
    return lines


def _row(name: str, strength: str, rows: Sequence[SensorScore], found: str) -> str:
    cured = f"{_right(rows)}/{sum(s.found for s in rows)}" if SENSOR_ILLNESSES[rows[0].illness].cured else ""
    noted, alarms = sum(s.noted for s in rows), sum(bool(s.alarms) for s in rows)
    return f"| {name} | {strength} | {len(rows)} | {found} | {noted} | {cured} | {alarms} |"


def _right(scores: Sequence[SensorScore]) -> int:
    return sum(s.cure == "right" for s in scores)


def _name(one: SensorScore) -> str:
    return f"{one.illness} ({one.strength:g} {one.unit})"


def _listed(title: str, entries: Sequence[tuple[SensorScore, str]]) -> list[str]:
    if not entries:
        return []
    lines = [f"- {s.seed} ({s.behaviour}, {s.layout}; {s.illness or 'healthy'}): {text}" for s, text in entries]
    return [f"## {title}", "\n".join(lines)]
