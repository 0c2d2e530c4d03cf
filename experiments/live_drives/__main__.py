"""`python -m experiments.live_drives courses --out live-drives` and `… memory`."""

import json
import logging
import re
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import tyro

from experiments.command import run
from experiments.live_drives.status import Part, draw, read_status
from experiments.live_faults.network import Router
from experiments.live_faults.programs import started
from offpiste.closed_loop.courses import CourseSettings
from offpiste.closed_loop.drive_course import CourseDriveSettings, drive_course
from offpiste.closed_loop.scores import scores_of
from offpiste.core.conventions import PERCEPTION_LATENCY
from offpiste.core.errors import LiveError
from offpiste.core.files import write_text
from offpiste.report.figure import write_png
from offpiste.report.text_table import TextTable, number
from offpiste.runtime.planner import load_planner
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.world.world import WorldSettings

logger = logging.getLogger("experiments")

RIG: Final = "proving_ground_gear"
LIMIT: Final = 60.0
"""Longest drive on a course [s]."""
_WAITS: Final = 180.0
"""Live and the simulator may take so long to load and to compile [s]."""
_COST: Final = re.compile(r"(?P<ending>finished|[\d.]+ of [\d.]+ m) in (?P<time>[\d.]+) s,.* cost (?P<cost>\d+);")
"""What `simulate --live` says at the end."""


@dataclass(frozen=True)
class LiveDrives:
    """Whole drives of `offpiste live` on this machine; a folder that has a drive's result is not driven again."""

    what: Annotated[Literal["courses", "memory"], tyro.conf.Positional]
    """courses: each driven live, and in lockstep. memory: half an hour of a log, played again and again."""
    out: Path = Path("live-drives")
    """Folder of all outputs."""
    run_folder: str = "pretrained:proving-ground/dc"
    """The run that drives."""
    world: str = "dunes"
    """World that is driven through."""
    seeds: tuple[int, ...] = (1, 2, 3, 4, 5)
    """Seeds of the courses."""
    speed: float = 5.0
    """Wanted on courses [m/s]."""
    latency: float = PERCEPTION_LATENCY
    """Latency of `live`, from the data of a plan to its first control [s]; lockstep has the default."""
    log: Path | None = None
    """For `memory`: a log of the proving ground with its sensors, as `simulate --out` writes it."""
    minutes: float = 30.0
    """For `memory`: how long it drives."""

    def run(self) -> str:
        """Drive what has not been driven, and tabulate."""
        self.out.mkdir(parents=True, exist_ok=True)
        table = self._courses() if self.what == "courses" else self._memory()
        write_text(self.out / f"{self.what}.md", table.markdown())
        return table.text()

    def _courses(self) -> TextTable:
        rows = []
        for seed in self.seeds:
            path = self.out / f"{self.world}-{seed}" / "costs.json"
            if not path.exists():
                result = {
                    "seed": seed,
                    "live": self._live(seed, path.parent),
                    "lockstep": self._lockstep(seed, path.parent),
                }
                write_text(path, json.dumps(result, indent=2))
            rows.append(json.loads(path.read_text("utf-8")))
            logger.info(
                f"{self.world} {seed}: {rows[-1]['live']['cost']} live, {rows[-1]['lockstep']['cost']:.0f} in lockstep"
            )
        return courses_table(rows)

    def _live(self, seed: int, folder: Path) -> dict[str, Any]:
        """Drive a course over the transport; what the simulator says of it, and how late everything was."""
        folder.mkdir(parents=True, exist_ok=True)
        said, status = folder / "simulate.txt", folder / "status.csv"
        simulator = ["simulate", "--live", "--world", self.world, "--seed", str(seed), "--speed", str(self.speed),
                     "--seconds", str(LIMIT + _WAITS)]  # fmt: skip
        live = ["live", RIG, "--run", self.run_folder, "--drive", "--clock", "clock", "--course-topic", "/course",
                "--speed", str(self.speed), "--latency", str(self.latency), "--status", str(status)]  # fmt: skip
        with (
            router_at() as at,
            started([*simulator, "--endpoint", at], said) as one,
            started([*live, "--endpoint", at], folder / "live.txt"),
        ):
            try:
                one.wait(LIMIT + 2 * _WAITS)
            except subprocess.TimeoutExpired as error:
                raise LiveError("the simulator does not end", where=said, how="see live.txt beside it") from error
        found = _COST.search(said.read_text("utf-8"))
        if found is None:
            raise LiveError("the vehicle was not driven", where=said, how="see live.txt beside it")
        control = read_status(status)["control"]
        worst = {key: control.worst(key) for key in ("tick_p99_ms", "map_age_p99_ms", "plan_age_p99_ms")}
        return {
            "finished": found["ending"] == "finished",
            "cost": int(found["cost"]),
            "time_s": float(found["time"]),
        } | worst

    def _lockstep(self, seed: int, folder: Path) -> dict[str, Any]:
        settings = CourseDriveSettings(
            WorldSettings(self.world, seed), LIMIT, course=CourseSettings(speed=self.speed), keep_log=False
        )
        driven = drive_course(load_planner(self.run_folder), settings, folder / "lockstep")
        result = scores_of(driven.driving.from_first_throttle, driven.chosen.course, LIMIT, load_vehicle())
        return {"finished": result["finished"], "cost": result["driven_cost"], "time_s": result["time_s"]}

    def _memory(self) -> TextTable:
        if self.log is None:
            raise LiveError(
                "no log to play", where="--log", how="make one: offpiste simulate --seconds 60 --out drive.mcap"
            )
        status = self.out / "status.csv"
        if not status.exists():
            self._play(self.log, status)
        parts = read_status(status)
        write_png(self.out / "memory.png", draw(parts), dpi=110)
        return memory_table(parts)

    def _play(self, log: Path, status: Path) -> None:
        """Play a log to a drive in shadow mode, again and again; each time the clock goes back."""
        live = ["live", RIG, "--run", self.run_folder, "--clock", "clock", "--goal", "1000", "0",
                "--speed", str(self.speed), "--seconds", str(60 * self.minutes), "--status", str(status)]  # fmt: skip
        play = ["play", str(log), "--rig", RIG]
        end = time.monotonic() + 60 * self.minutes + _WAITS
        with router_at() as at, started([*live, "--endpoint", at], self.out / "live.txt") as drives:
            while drives.poll() is None and time.monotonic() < end:
                with started([*play, "--endpoint", at], self.out / "play.txt") as player:
                    while player.poll() is None and drives.poll() is None and time.monotonic() < end:
                        time.sleep(0.5)


@contextmanager
def router_at() -> Iterator[str]:
    """A router in a process of its own: its endpoint."""
    router = Router()
    try:
        yield f"tcp/127.0.0.1:{router.port}"
    finally:
        router.kill()


def courses_table(rows: Sequence[dict[str, Any]]) -> TextTable:
    """A line a course, and the median ratio of the costs."""
    lines = []
    for row in rows:
        live, lockstep = row["live"], row["lockstep"]
        lines.append(
            (
                str(row["seed"]),
                *(f"{each['cost']:.0f}{'' if each['finished'] else ' (not finished)'}" for each in (live, lockstep)),
                f"{100 * (live['cost'] / lockstep['cost'] - 1):+.0f} %",
                *(number(live[key], 0) for key in ("tick_p99_ms", "map_age_p99_ms", "plan_age_p99_ms")),
            )
        )
    ratio = np.median([row["live"]["cost"] / row["lockstep"]["cost"] for row in rows])
    lines.append(("median", "", "", f"{100 * (ratio - 1):+.0f} %", "", "", ""))
    names = (
        "course",
        "cost live",
        "in lockstep",
        "difference",
        "tick p99 [ms]",
        "map's age p99 [ms]",
        "plan's age p99 [ms]",
    )
    about = (
        "Driven costs of the same courses, from the first throttle on; ticks of control late by, and ages at the worst "
        "moment of each drive. One that does not finish counts as standing until its limit, "
        f"{LIMIT:g} s in lockstep and longer live."
    )
    return TextTable("Courses live", names, tuple(lines), about)


def memory_table(parts: dict[str, Part]) -> TextTable:
    """A line a process: its share of a core, its memory, and how that grows."""
    lines = []
    for name, part in parts.items():
        memory = part.numbers["rss_mb"]
        seen = memory[np.isfinite(memory)]
        if not len(seen):
            continue
        lines.append(
            (
                name,
                number(100 * part.share_of_core(), 0),
                number(float(seen.max()), 0),
                number(float(seen[-1]), 0),
                number(part.growth(), 1),
            )
        )
    about = "Growth: a line through its memory from 5 minutes after the start on."
    return TextTable(
        "Processes", ("process", "of a core [%]", "most [MB]", "last [MB]", "growth [MB/h]"), tuple(lines), about
    )


if __name__ == "__main__":
    run(LiveDrives)
