"""Drives of several planners on many courses, each done once; resumes from its folder."""

import io
import json
import shutil
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from experiments.closed_loop_table.table import COUNTED, MEASURES
from offpiste.closed_loop.courses import course_world
from offpiste.closed_loop.drive_course import (
    CourseDriveSettings,
    check_settings,
    described,
    drive_course,
    settings_of,
)
from offpiste.core.errors import CourseError, OffpisteError, RunError
from offpiste.core.files import check_folder
from offpiste.core.parallel import run_all
from offpiste.planning.caution import AsPredicted, risk_of
from offpiste.runtime.planner import Planner
from offpiste.simulation.rendering.scene import world_scene
from offpiste.simulation.world.world import WorldSettings

DEVELOPMENT, TEST = 1, 646
"""First seeds of the courses: everything is chosen on the first, and evaluated on the second."""

WORLDS: Final = ("mojave", "halter-ranch", "coastal-scrub", "dunes")
"""Worlds of the courses, in turn."""

NEEDED: Final = (
    "world", "seed", "course", "firm_way", "modes", "final_speed_mps", "commit", "date", *MEASURES, *COUNTED,
)  # fmt: skip
"""Entries of results that are read."""


@dataclass(frozen=True)
class Entry:
    """A model that plans at a latency [s], with a risk."""

    planner: Planner
    latency: float = 0.1
    risk: str = "none"

    @property
    def row(self) -> str:
        """Name of the row, which the runs of all seeds share."""
        more = [self.risk.replace(":", "-")] * (self.risk != "none")
        return f"{'+'.join((self.planner.name, *more))}-{round(1000 * self.latency)}ms"

    @property
    def name(self) -> str:
        """Name of the folder."""
        return f"{self.row}-{self.planner.seed}"


def entries(
    planners: Sequence[Planner],
    latencies: Sequence[float] = (0.0, 0.3),
    risks: Sequence[str] = ("none",),
) -> list[Entry]:
    """Return all planners at 0.1 s, and the first run that knows the ground ahead also at other latencies, each once.

    Args:
        risks: of plans; other ones than none are driven by the runs that have a spread.

    Raises:
        OffpisteError: two planners have one name and one seed, and so one folder; or no run has the spread that a risk
            needs.
    """
    named: dict[tuple[str, int], Planner] = {}
    for planner in planners:
        if (first := named.setdefault((planner.name, planner.seed), planner)) is not planner:
            raise OffpisteError(
                f"both are '{planner.name}' of seed {planner.seed}, and would drive into one folder",
                where=f"{first.folder} and {planner.folder}",
                how="give one run of a model and seed, and the other in a command of its own with another --out",
            )
    wanted = dict.fromkeys(round(latency, 6) for latency in latencies)
    wanted.pop(Entry.latency, None)
    firsts = {p.name: p for p in reversed(planners) if p.name in ("dc", "ceiling")}
    wide = [Entry(p, latency) for p in planners if firsts.get(p.name) is p for latency in wanted]
    for risk in risks:
        if risk_of(risk) != AsPredicted() and not any(planner.spread for planner in planners):
            how = "`offpiste calibrate` makes one for a run"
            raise OffpisteError(f"none of the runs has a spread for {risk}", where="--risks", how=how)
    cautious = [Entry(p, risk=risk) for risk in dict.fromkeys(risks) if risk != "none" for p in planners if p.spread]
    return [*(Entry(p) for p in planners), *wide, *cautious]


class Place(NamedTuple):
    """World and kind of a course."""

    world: WorldSettings
    kind: str

    @property
    def name(self) -> str:
        """Name of the folder of a drive on it."""
        return f"{self.kind}-{self.world.preset}-{self.world.seed}"


def places(first: int, courses: int, kinds: Sequence[str] = ("bends",)) -> list[Place]:
    """Return worlds and kinds of some courses, with seeds from `first` on; kinds and worlds in turn."""
    numbers = range(courses)
    return [Place(WorldSettings(WORLDS[n % len(WORLDS)], first + n), kinds[n % len(kinds)]) for n in numbers]


def drive_all(
    rows: Sequence[Entry],
    worlds: Sequence[Place],
    out: Path,
    settings: CourseDriveSettings | None = None,
    *,
    processes: int = 1,
) -> list[dict[str, Any]]:
    """Drive missing courses; return all results. Worlds without a course of their kind are left out.

    Args:
        processes: courses that are driven at a time, each by all planners.

    Raises:
        RunError: the folder holds drives of other settings or runs.
        OffpisteError: a setting is out of range, the folder is a file, or a result in it is broken: nothing is driven
            then. Or a course cannot be driven, the others are; or no world has a course.
    """
    settings = settings or CourseDriveSettings()
    check_folder(out)
    for row in rows:
        check_settings(_of_entry(settings, row))
    courses = [
        (world, [row for row in rows if _finished_result(row, world, out, settings) is None]) for world in worlds
    ]
    failed = run_all(
        partial(_drive_rows, out=out, settings=settings), [c for c in courses if c[1]], processes, "courses"
    ).failed
    found = [(row, _finished_result(row, world, out, settings)) for world in worlds for row in rows]
    results = [{**result, "row": row.row, "run_seed": row.planner.seed} for row, result in found if result is not None]
    fatal = [error for error in failed if not results or not isinstance(error, CourseError)]
    if fatal:
        raise fatal[0]
    return results


def _drive_rows(
    course: tuple[Place, list[Entry]],
    report: Callable[[float], None],
    *,
    out: Path,
    settings: CourseDriveSettings,
) -> str:
    """Drive a course with several planners, one after the other."""
    (place, rows), message = course, []
    world = course_world(*place)
    scene = world_scene(world)
    for number, row in enumerate(rows):
        drive, folder = _on_course(_of_entry(settings, row), place), _folder(row, place, out)
        shutil.rmtree(folder, ignore_errors=True)  # left by an interrupted drive
        with redirect_stderr(io.StringIO()):  # progress bars of parallel drives would overlap
            result = drive_course(row.planner, drive, folder, world=world, scene=scene).result
        message.append(f"{row.name}: {described(result)}")
        report((number + 1) / len(rows))
    return "\n".join(message)


def _of_entry(settings: CourseDriveSettings, row: Entry) -> CourseDriveSettings:
    return replace(settings, runtime=replace(settings.runtime, latency=row.latency, risk=risk_of(row.risk)))


def _on_course(settings: CourseDriveSettings, place: Place) -> CourseDriveSettings:
    return replace(settings, world=place.world, course=replace(settings.course, kind=place.kind))


def _folder(row: Entry, place: Place, out: Path) -> Path:
    return out / row.name / place.name


def _finished_result(row: Entry, place: Place, out: Path, settings: CourseDriveSettings) -> dict[str, Any] | None:
    """Return the result of a finished drive, if any."""
    folder = _folder(row, place, out)
    path = folder / "result.json"
    if not path.exists():
        return None
    wanted = settings_of(row.planner, _on_course(_of_entry(settings, row), place))
    result = _read(path, [*NEEDED, *wanted])
    if other := [name for name, value in wanted.items() if result[name] != value]:
        raise RunError(f"a drive with another {other[0]}", where=folder, how="give another --out")
    return result


def _read(path: Path, needed: Sequence[str]) -> dict[str, Any]:
    """Read the result of a drive, with all needed entries."""
    how = "remove it, and the course is driven again"
    try:
        result = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise OffpisteError(f"cannot be read: {error}", where=path, how=how) from error
    if not isinstance(result, dict):
        raise OffpisteError("is not the result of a drive", where=path, how=how)
    if lacking := [name for name in needed if name not in result]:
        raise OffpisteError(f"lacks {lacking[0]!r}", where=path, how=how)
    return result
