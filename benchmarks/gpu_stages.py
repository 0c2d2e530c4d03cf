"""All that needs an NVIDIA GPU, stage by stage: each has a time limit, a log and its rows; one that fails stops none.

`python benchmarks/gpu_stages.py [FOLDER] [--device cuda] [--small] [--only STAGE ...]`, or `bash benchmarks/gpu.sh`.
FOLDER gets a log for each stage, and after each stage `gpu.json` and `gpu.md`. The exit code is 1 where a stage failed.
"""

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
WHOLE = 590.0
"""Seconds of all stages together."""

TESTS: tuple[str, ...] = ("tests/dynamics/header/test_cuda.py", "tests/native/test_cuda_kernels.py")
TESTS += ("tests/dynamics/test_base.py",)
TESTS += ("tests/perception/backbones/test_backbone.py", "tests/planning/test_mppi.py")

RENAMED = ("CUFFT_INCOMPLETE_PARAMETER_LIST", "CUFFT_PARSE_ERROR", "CUFFT_LICENSE_ERROR")
"""Names of errors that CUDA 13 took away, and that MPPI-Generic still has."""


SAMPLES = (1024, 8192)
"""Of plans by MPPI-Generic."""


BLOCKS = ("8 8", "8 16", "16 8")
"""Shapes of its blocks for dynamics of its own, the best of six (docs/gpu.md)."""


class Skipped(Exception):
    """Why a stage is not run."""


class Stage(NamedTuple):
    """A part of the run.

    Attributes:
        seconds: limit.
        command: of a folder and options; raises `Skipped`.
    """

    name: str
    seconds: float
    command: Callable[[Path, argparse.Namespace], list[str]]


def by_script(stage: str) -> Callable[[Path, argparse.Namespace], list[str]]:
    """A stage of gpu.py, which writes its rows as it goes along."""

    def command(folder: Path, given: argparse.Namespace) -> list[str]:
        if stage == "pytorch-mppi" and find_spec("pytorch_mppi") is None:
            raise Skipped("pytorch_mppi is not installed")
        small = ["--small"] if given.small else []
        if stage == "train":
            if given.dataset is None:
                raise Skipped("it needs --dataset")
            small += ["--dataset", str(given.dataset)]
        out = str(folder / f"{stage}.json")
        return [sys.executable, str(HERE / "gpu.py"), stage, "--device", given.device, "--out", out, *small]

    return command


def tool(name: str) -> str:
    """Where a program is; `Skipped` without it."""
    found = shutil.which(name)
    if found is None:
        raise Skipped(f"{name} is not there")
    return found


def checked_accesses(folder: Path, given: argparse.Namespace) -> list[str]:
    """A small run in which each array is an allocation of its own, so that memcheck knows where it ends.

    Calls that fail do not count: cuda-core asks a driver for functions of later versions, and copes without them.
    """
    out = str(folder / "memcheck.json")
    small = [sys.executable, str(HERE / "gpu.py"), "plans", "spread", "training", "--small", "--device", given.device]
    memcheck = [tool("compute-sanitizer"), "--tool", "memcheck", "--report-api-errors", "no", "--error-exitcode", "1"]
    return [*memcheck, *small, "--out", out]


def tests(folder: Path, given: argparse.Namespace) -> list[str]:
    """The tests that need a GPU or NVRTC."""
    if find_spec("pytest") is None:
        raise Skipped("pytest is not installed")
    chosen = ["-k", "nvrtc or a_gpu or cuda_gives or test_cuda_kernels"]
    return [sys.executable, "-m", "pytest", "-q", "-rs", *chosen, *(str(HERE.parent / file) for file in TESTS)]


def example(folder: Path, given: argparse.Namespace) -> list[str]:
    """The exported CUDA example, on the drives of the parity file."""
    return exported(folder, "cuda", f"{tool('nvcc')} -std=c++17 -O3 -arch=native example.cu -o it && ./it parity.bin")


def planner(folder: Path, given: argparse.Namespace) -> list[str]:
    """The exported planner for MPPI-Generic, and its own LSTM dynamics, where that library's sources are."""
    sources = Path(os.environ.get("MPPI_GENERIC", HERE.parents[1] / "MPPI-Generic")) / "include"
    eigen = Path(os.environ.get("EIGEN", "/usr/include/eigen3"))
    for place, name in ((sources, "MPPI_GENERIC"), (eigen, "EIGEN")):
        if not place.is_dir():
            raise Skipped(f"{place} is not there; set {name}")
    nvcc = tool("nvcc")
    version = re.search(r"release (\d+)", subprocess.run([nvcc, "--version"], capture_output=True, text=True).stdout)
    newer = version is not None and int(version[1]) >= 13
    flags = " ".join(f"-D{name}={901 + number}" for number, name in enumerate(RENAMED) if newer)
    own = HERE / "mppi_generic_own"
    compiler = f"{nvcc} -std=c++17 -O3 -w -arch=native --extended-lambda -I '{own}' -I '{sources}' -I '{eigen}' {flags}"
    sources_of = {"planner": "planner.cu", "own": f"'{own / 'own.cu'}'"}
    made = [
        f"{compiler} -DSAMPLES={samples} {source} -o {name}-{samples} -lcurand -lcufft & all+=($!)"
        for name, source in sources_of.items()
        for samples in SAMPLES
    ]
    lines = ["all=()", *made, 'for each in "${all[@]}"; do wait "$each"; done']
    for samples in SAMPLES:
        lines += [f"./planner-{samples} parity.bin | tee -a times"]
        lines += [f"./own-{samples} {block} | tee -a times || echo 'no blocks of {block}'" for block in BLOCKS]
    lines += ["grep -oh '[0-9]* x 250 takes .*' times | paste -sd ';'"]
    return exported(folder, "mppi-generic", "\n".join(lines))


def exported(folder: Path, kind: str, command: str) -> list[str]:
    """A shell command in a fresh export."""
    shutil.rmtree(folder / kind, ignore_errors=True)
    export = (
        f"'{sys.executable}' -m offpiste export pretrained:proving-ground/dc --to '{folder / kind}' --format {kind}"
    )
    return ["bash", "-euo", "pipefail", "-c", f"{export}\ncd '{folder / kind}'\n{command}"]


STAGES = (
    Stage("plans", 150, by_script("plans")),
    Stage("spread", 60, by_script("spread")),
    Stage("images", 60, by_script("images")),
    Stage("training", 120, by_script("training")),
    Stage("train", 150, by_script("train")),
    Stage("example", 60, example),
    Stage("memcheck", 150, checked_accesses),
    Stage("pytorch-mppi", 120, by_script("pytorch-mppi")),
    Stage("pytest", 90, tests),
    Stage("mppi-generic", 200, planner),
)
"""What matters most comes first: the last ones may find no time left."""


def ended(command: list[str], log: Path, seconds: float, **more: str) -> str:
    """Run a command, its output into a log; why it failed, "" where it did not."""
    with log.open("w") as out:
        process = subprocess.Popen(
            command, stdout=out, stderr=subprocess.STDOUT, env=os.environ | more, start_new_session=True
        )
        try:
            code = process.wait(timeout=seconds)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            return f"stopped after {seconds:.0f} s"
    return f"exit code {code}: {last_line(log)}" if code else ""


def last_line(log: Path) -> str:
    """What a log ends with."""
    lines = [line.strip() for line in log.read_text("utf-8", "replace").splitlines() if line.strip()]
    return lines[-1][:1000] if lines else "no output"


def run(stage: Stage, folder: Path, given: argparse.Namespace, seconds: float) -> dict[str, object]:
    """What came of a stage: rows, and why it failed or was skipped."""
    log, rows = folder / f"{stage.name}.log", folder / f"{stage.name}.json"
    rows.unlink(missing_ok=True)
    if seconds < 1:
        return {"stage": stage.name, "skipped": "no time was left"}
    try:
        command = stage.command(folder, given)
    except Skipped as reason:
        return {"stage": stage.name, "skipped": str(reason)}
    uncached = {"PYTORCH_NO_CUDA_MEMORY_CACHING": "1"} if stage.name == "memcheck" else {}
    failed = ended(command, log, min(stage.seconds, seconds), **uncached)
    result: dict[str, object] = {"stage": stage.name, "rows": json.loads(rows.read_text()) if rows.exists() else []}
    return result | (
        {"failed": f"{failed} (see {log.name})"} if failed else ({} if result["rows"] else {"said": last_line(log)})
    )


def table(results: list[dict[str, object]]) -> str:
    """Results as Markdown."""
    lines = ["| stage | what | median [ms] | best [ms] |", "|---|---|---|---|"]
    for result in results:
        name = result["stage"]
        for row in result.get("rows", []):  # type: ignore[attr-defined]
            numbers = f"{row['median']:.2f} | {row['best']:.2f}" if "median" in row else "|"
            lines.append(f"| {name} | {row['what']} | {numbers} |")
        for kind in ("skipped", "failed", "said"):
            if kind in result:
                text = str(result[kind]).replace("|", "/")
                lines.append(f"| {name} | {'done' if kind == 'said' else kind}: {text} | | |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Run the stages."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("gpu-results"))
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--small", "--smoke", action="store_true", help="few samples: to try the stages themselves")
    parser.add_argument("--only", nargs="*", choices=[stage.name for stage in STAGES], help="these stages")
    parser.add_argument("--dataset", type=Path, help="of the stage `train`, with features; skipped without")
    given = parser.parse_args()
    folder = given.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    if failed := ended([sys.executable, str(HERE / "gpu.py"), "--device", given.device], folder / "device.log", 90):
        print(f"no stage was run: {failed}", file=sys.stderr)
        return 1
    print(last_line(folder / "device.log"))
    results: list[dict[str, object]] = []
    for stage in STAGES:
        if given.only and stage.name not in given.only:
            continue
        results.append(run(stage, folder, given, WHOLE - (time.monotonic() - began)))
        shown = f"{last_line(folder / 'device.log')}\n\n{table(results)}"
        (folder / "gpu.md").write_text(shown)
        (folder / "gpu.json").write_text(json.dumps(results, indent=2) + "\n")
        print("\n".join(table(results[-1:]).splitlines()[2:]), flush=True)
    return int(any("failed" in result for result in results))


if __name__ == "__main__":
    sys.exit(main())
