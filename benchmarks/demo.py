"""Time, memory and outcome of `offpiste demo` over seeds: `python benchmarks/demo.py --out demos`.

Memory is the proportional set size of all its processes together,
sampled twice a second. Seeds that are there already are not run again.
"""

import argparse
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path


def main(arguments: Sequence[str] | None = None) -> None:
    """Run, and print a table and what it says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("demos"))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--smoke", action="store_true", help="measure `offpiste --version` only, to try it")
    given = parser.parse_args(arguments)
    if given.smoke:
        given.out.mkdir(parents=True, exist_ok=True)
        taken = measured([sys.executable, "-m", "offpiste", "--version"], given.out / "version.log")
        print(f"{taken['seconds']:.1f} s, {taken['gib']:.2f} GiB")
        return
    given.out.mkdir(parents=True, exist_ok=True)
    runs = [run(given.out / f"seed-{seed}", seed) for seed in range(given.seeds)]
    times, most = [r["seconds"] for r in runs], max(r["gib"] for r in runs)
    listed = ", ".join(f"{seconds:.0f}" for seconds in times)
    print(f"median {statistics.median(times):.0f} s ({listed}), {most:.2f} GiB")
    print("| seed | b off by [m] | dc off by [m] | driven cost of b | of dc | finished |\n|---|---|---|---|---|---|")
    outcomes = [json.loads((given.out / f"seed-{seed}" / "demo.json").read_text()) for seed in range(given.seeds)]
    for seed, outcome in enumerate(outcomes):
        errors, courses = outcome["error_m"], outcome["courses"]
        ends = " and ".join(model for model in courses if courses[model]["finished"]) or "none"
        costs = " | ".join(f"{courses[model]['driven_cost']:.0f}" for model in ("b", "dc"))
        print(f"| {seed} | {errors['b']:.2f} | {errors['dc']:.2f} | {costs} | {ends} |")
    nearer = sum(outcome["error_m"]["dc"] < outcome["error_m"]["b"] for outcome in outcomes)
    ratios = [o["courses"]["dc"]["driven_cost"] / o["courses"]["b"]["driven_cost"] for o in outcomes]
    less, more = sum(ratio < 0.99 for ratio in ratios), sum(ratio > 1.01 for ratio in ratios)
    of = len(outcomes)
    print(f"dc predicts nearer in {nearer} of {of}, and drives the course at less cost in {less}, at more in {more}")


def run(out: Path, seed: int) -> dict[str, float]:
    """Run a demo once; what it took."""
    path = out.with_suffix(".json")
    if not path.exists():
        command = [sys.executable, "-m", "offpiste", "demo", "--seed", str(seed), "--out", str(out)]
        path.write_text(json.dumps(measured(command, Path(f"{out}.log"))))
    return json.loads(path.read_text())


def measured(command: list[str], log: Path) -> dict[str, float]:
    """Run a command; return its time [s] and largest memory [GiB]."""
    began, most = time.perf_counter(), 0.0
    with log.open("w") as opened:
        process = subprocess.Popen(command, stdout=opened, stderr=opened)
        while process.poll() is None:
            most = max(most, _memory(process.pid))
            time.sleep(0.5)
    if process.returncode:
        sys.exit(f"{' '.join(command)} ended with {process.returncode}: {log}")
    return {"seconds": time.perf_counter() - began, "gib": most}


def _memory(pid: int) -> float:
    """Proportional set size of a process and all below it [GiB]."""
    total = 0.0
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
        total = sum(float(line.split()[1]) for line in lines if line.startswith("Pss:")) / 2**20
        below = [child for file in Path(f"/proc/{pid}/task").glob("*/children") for child in file.read_text().split()]
    except (OSError, ProcessLookupError):
        return total  # it has just ended
    return total + sum(_memory(int(child)) for child in below)


if __name__ == "__main__":
    main()
