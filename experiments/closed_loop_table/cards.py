"""What courses showed, on the cards of models that ship."""

from collections.abc import Sequence
from typing import Any

import msgspec

from experiments.closed_loop_table.drives import entries
from experiments.closed_loop_table.table import by_row, driven_cost_against
from offpiste.core.errors import RunError
from offpiste.evaluation.model_card import CARD, CourseFigures, load_card, write_card
from offpiste.runtime.planner import Planner


def write_driving(planners: Sequence[Planner], results: Sequence[dict[str, Any]], limit: float) -> None:
    """Write each planner's driven cost against that of `b` into the card of its run, where it has one.

    Args:
        results: of all courses, as in the table.
        limit: of a drive's time [s].

    Raises:
        RunError: none of the planners is `b`, or there are too few courses for an interval.
    """
    drives = by_row(results)
    rows = {entry.planner.folder: entry.row for entry in entries(planners, ())}
    base = next((row for row in rows.values() if row.startswith("b-")), None)
    if base is None:
        raise RunError("no `b` to compare with", where="--runs", how="give the `b` that ships, too")
    for folder, row in rows.items():
        if row == base or not (folder / CARD).exists():
            continue
        found = driven_cost_against(drives, row, base, limit)
        if found is None:
            raise RunError("too few courses for an interval", where=folder, how="give --courses 20")
        courses = len(next(iter(drives[row].values())))
        mine = [result for result in results if result["row"] in (row, base)]
        commits = sorted({result["commit"] for result in mine})
        driving = CourseFigures(courses, found, ", ".join(commits), max(result["date"] for result in mine))
        write_card(folder, msgspec.structs.replace(load_card(folder), driving=driving))
