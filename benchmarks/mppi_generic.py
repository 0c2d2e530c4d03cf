"""The export for MPPI-Generic, compiled against that library's sources and driven on its host path; no GPU needed.

`python benchmarks/mppi_generic.py SOURCES --eigen FOLDER [--include FOLDER ...] [--planner]`: SOURCES is a checkout of
ACDSLab/MPPI-Generic, and the folder of Eigen has `Eigen/Dense`. nvcc compiles; cuRAND's and cuFFT's headers may lie in
further folders. `--planner` also compiles the planner, which takes minutes, and prints what its kernels need.
"""

import argparse
import re
import subprocess
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from offpiste.export.formats import export_run

REMOVED = ("CUFFT_INCOMPLETE_PARAMETER_LIST", "CUFFT_PARSE_ERROR", "CUFFT_LICENSE_ERROR")
"""Names of errors that CUDA 13 took away, and that MPPI-Generic still has."""

KERNELS = (
    r"entry function '\S*?(rolloutKernel|rolloutDynamicsKernel)I.*?(\d+) bytes spill stores.*?Used (\d+) registers"
)


def compiled(folder: Path, name: str, flags: list[str], *, link: bool = True) -> str:
    """Compile a file of an export; what nvcc says."""
    output = ["-o", name] if link else ["-c", "-o", f"{name}.o"]
    command = ["nvcc", "-std=c++17", "-w", "-arch=sm_90", *flags, f"{name}.cu", *output]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr[:3000])
    return done.stderr


def main() -> None:
    """Export, compile, drive, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sources", type=Path)
    parser.add_argument("--eigen", type=Path, required=True)
    parser.add_argument("--include", type=Path, nargs="*", default=[])
    parser.add_argument("--run", default="pretrained:proving-ground/dc")
    parser.add_argument("--planner", action="store_true")
    given = parser.parse_args()
    places = [given.sources / "include", given.eigen, *given.include]
    flags = [f"-I{place.resolve()}" for place in places] + [f"-D{name}={901 + i}" for i, name in enumerate(REMOVED)]
    with TemporaryDirectory() as made:
        folder = Path(made) / "export"
        export_run(given.run, folder, "mppi-generic")
        compiled(folder, "drive", ["-O2", *flags])
        before = time.perf_counter()
        drive = subprocess.run(["./drive", "parity.bin"], cwd=folder, capture_output=True, text=True)
        print(f"{drive.stdout.splitlines()[-1]} ({time.perf_counter() - before:.2f} s, exit code {drive.returncode})")
        if given.planner:
            said = compiled(folder, "planner", ["-O3", "--extended-lambda", "-Xptxas", "-v", *flags], link=False)
            for kernel, spilled, registers in re.findall(KERNELS, said, re.DOTALL):
                print(f"{kernel}: {registers} registers, {spilled} bytes spilled")
    raise SystemExit(drive.returncode)


if __name__ == "__main__":
    main()
