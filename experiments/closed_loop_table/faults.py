"""Faults of the sensors, each driven once: while driving, from the start, where the vehicle stands, and in reverse."""

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from experiments.closed_loop_table.drives import Place, drive_all, entries
from offpiste.closed_loop.drive_course import CourseDriveSettings
from offpiste.closed_loop.lockstep import KINDS
from offpiste.core.files import write_text
from offpiste.report.text_table import TextTable, number
from offpiste.runtime.planner import Planner

logger = logging.getLogger("experiments")

MOMENTS: Final[Mapping[str, Mapping[str, Any]]] = {
    "driving": {},
    "standing": {"fault_start": 0.0},
    "reversing": {"against": True, "fault_start": 0.0, "fault_when": "reversing"},
}
"""When a fault begins, by what the vehicle does: after 10 s, at its standing start, or when it first drives backwards,
for which it starts against its course."""

ABOUT: Final = (
    "Each fault lasts to the end of the drive. Reversing: the vehicle starts against its course and is to turn round; "
    "none: the same drive without a fault. At the end: speed, and how much of the course is driven."
)


def drive_faults(
    planners: Sequence[Planner], worlds: Sequence[Place], out: Path, settings: CourseDriveSettings, *, processes: int
) -> str:
    """Drive each fault at each moment, and what each moment is without one; write and return the table.

    Raises:
        RunError, OffpisteError: as `drive_all`.
    """
    results = list[dict[str, Any]]()
    for moment, changed in MOMENTS.items():
        for kind in KINDS:
            folder = out / "faults" / (kind if moment == "driving" else f"{kind}-{moment}")
            faulty = replace(settings, **{"fault": kind, **changed})
            for result in drive_all(entries(planners, ()), worlds, folder, faulty, processes=processes):
                results.append({**result, "moment": moment})
                logger.info(f"  {kind}, {moment}: {_modes(result)}")
    table = fault_table(results)
    write_text(out / "faults" / "faults.json", json.dumps({"schema": 1, "results": results}, indent=1))
    write_text(out / "faults" / "faults.md", table.markdown())
    return table.text(width=160)


def fault_table(results: Sequence[Mapping[str, Any]]) -> TextTable:
    """A line a drive."""
    names = ("fault", "begins while", "run", "course", "changes of mode", "at the end [m/s]", "driven [%]", "damage")
    damages = ("rollover", "collision", "left_world")
    lines = [
        (
            result["fault"],
            result["moment"],
            result["row"],
            f"{result['world']} {result['seed']}",
            _modes(result),
            number(result["final_speed_mps"], 1),
            number(100 * min(result["progress_m"] / result["course_m"], 1), 0),
            ", ".join(name for name in damages if result[name]) or "none",
        )
        for result in results
    ]
    return TextTable("Faults", names, tuple(lines), ABOUT, left=5)


def _modes(result: Mapping[str, Any]) -> str:
    return "; ".join(f"{time} s {mode}: {why}" for time, mode, why in result["modes"])
