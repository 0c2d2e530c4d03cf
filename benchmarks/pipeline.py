"""Throughput from driving to training, of two checkouts in turns: the table of docs/results.md.

    git worktree add /tmp/before COMMIT
    python benchmarks/pipeline.py --before /tmp/before --dataset results/dataset.zarr [--runs 3]

Every row is a command that runs with the code of one checkout and then of the other, with caches of their own, once
before anything is counted. Medians of wall clock, or of processor time where the row says so; memory is the largest
process's. Without `--before`, this checkout alone. Trainings are measured on `--dataset`, which has visual features and
actuators; without it they are left out.
"""

import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import tyro

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Taken:
    """What a command took: wall clock and processor time [s], memory of its largest process [GiB], what it printed."""

    wall: float
    processor: float
    memory: float
    text: str


@dataclass(frozen=True)
class Row:
    """A line of the table.

    Attributes:
        aim: what is to be reached, in words.
        command: arguments of Python, given the folder of a checkout's files.
        value: of what it took.
        text: how a value is written.
    """

    name: str
    aim: str
    command: Callable[[Path], list[str]]
    value: Callable[[Taken], float]
    text: str


def simulated(sensors: str, seconds: float) -> Callable[[Path], list[str]]:
    """Command that records a drive in a world of its own."""

    def command(work: Path) -> list[str]:
        log = work / f"{sensors}.mcap"
        log.unlink(missing_ok=True)
        what = ["--world", "mojave", "--seed", "3", "--seconds", f"{seconds:g}", "--sensors", sensors]
        return ["-m", "offpiste", "simulate", *what, "--out", str(log)]

    return command


def extracted(work: Path) -> list[str]:
    """Command that extracts the `light` drive."""
    out = work / f"dataset-{time.monotonic_ns()}.zarr"
    return ["-m", "offpiste", "extract", str(work / "light.mcap"), "--rig", "proving_ground", "--pca",
            "pretrained:proving-ground", "--processes", "1", "--out", str(out)]  # fmt: skip


def printed(pattern: str) -> Callable[[Taken], float]:
    """The number that a command prints."""

    def value(taken: Taken) -> float:
        found = re.search(pattern, taken.text)
        if found is None:
            sys.exit(f"no '{pattern}' in: {taken.text[-500:]}")
        return float(found[1])

    return value


def rows(seconds: float, full: float, dataset: Path | None) -> list[Row]:
    """The lines, in their order: the third reads what the first records."""
    table = [
        Row("simulate `light`", ">= 10", simulated("light", seconds), lambda t: seconds / t.wall, "{:.2f} x real time"),
        Row("simulate `full`", ">= 1", simulated("full", full), lambda t: full / t.wall, "{:.2f} x real time"),
        Row("extract `light`, processor", "<= 0.15", extracted, lambda t: t.processor / seconds, "{:.2f} s a second"),
    ]
    if dataset is not None:
        step_time = printed(r"step of dc: ([\d.]+) ms")
        parts = [str(ROOT / "benchmarks" / "train_actuators.py"), str(dataset)]
        step = [str(ROOT / "benchmarks" / "train.py"), str(dataset), "--step-only"]
        table += [
            Row("epoch of the actuators", "<= 3", lambda _: parts, printed(r"steps: ([\d.]+) s"), "{:.1f} s"),
            Row("step of `dc`, 1024 windows", "<= 350", lambda _: step, step_time, "{:.0f} ms"),
        ]
    return table


def take(command: list[str], checkout: Path, work: Path) -> Taken:
    """Run Python with a checkout's code."""
    caches = {name: str(work / "cache") for name in ("OFFPISTE_CACHE", "NUMBA_CACHE_DIR")}
    path = os.pathsep.join([str(checkout / "src"), str(checkout)])
    began, reading = time.perf_counter(), work / "output.txt"
    with reading.open("w") as output:
        process = subprocess.Popen(
            [sys.executable, *command], env=os.environ | caches | {"PYTHONPATH": path}, stdout=output, stderr=output
        )
        _, status, usage = os.wait4(process.pid, 0)
    wall, text = time.perf_counter() - began, reading.read_text()
    if status:
        sys.exit(f"{' '.join(command)} failed in {checkout}: {text[-500:]}")
    return Taken(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**20, text)


def main(
    before: Path | None = None,
    dataset: Path | None = None,
    runs: int = 3,
    seconds: float = 120.0,
    full_seconds: float = 60.0,
    only: str = "",
) -> None:
    """Run, and print the table.

    Args:
        before: checkout of the commit to compare with.
        dataset: with visual features and actuators, for what trainings take.
        runs: of every command; medians are printed.
        seconds, full_seconds: of the `light` and the `full` drive; in short ones start-up and the world weigh most.
        only: rows whose name contains this. What extraction reads is the `light` drive of the first row.
    """
    table = [row for row in rows(seconds, full_seconds, dataset.resolve() if dataset else None) if only in row.name]
    checkouts = {"before": before.resolve(), "after": ROOT} if before else {"after": ROOT}
    with tempfile.TemporaryDirectory(prefix="offpiste-pipeline-") as folder:
        works = {name: Path(folder) / name for name in checkouts}
        for work in works.values():
            work.mkdir()
        print("| | " + " | ".join(f"{name} | memory" for name in checkouts) + " | aim |")
        print("|---" * (2 + 2 * len(checkouts)) + "|")
        for row in table:
            taken: dict[str, list[Taken]] = {name: [] for name in checkouts}
            for _ in range(runs + 1):
                for name, checkout in checkouts.items():
                    taken[name].append(take(row.command(works[name]), checkout, works[name]))
            cells = []
            for counted in (each[1:] for each in taken.values()):
                value = statistics.median(row.value(one) for one in counted)
                cells += [row.text.format(value), f"{max(one.memory for one in counted):.2f} GiB"]
            print(f"| {row.name} | {' | '.join(cells)} | {row.aim} |", flush=True)


if __name__ == "__main__":
    tyro.cli(main)
