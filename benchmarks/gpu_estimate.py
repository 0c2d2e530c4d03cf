"""What the printed kernels should take on a GPU, from their machine code alone: estimates, not measurements.

`python benchmarks/gpu_estimate.py` compiles them with nvcc (no GPU needed) and counts registers, spilled bytes and the
instructions of the longest loop, which is one step. A warp alone on its scheduler issues 0.4 to 0.7 instructions a
cycle where each waits for the one before, and rollouts on a map wait for gathers from it.
"""

import re
import struct
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import plan as on_cpu

from offpiste.conventions import HORIZON_STEPS
from offpiste.cuda_kernels import lanes_of
from offpiste.dynamics.header.recorded import recorded_text
from offpiste.dynamics.header.step_text import LANES
from offpiste.planning.cost_map import cost_map
from offpiste.planning.costs.layers import Hazards
from offpiste.planning.course import Course
from offpiste.planning.header.cost_text import plan_text
from offpiste.training.run import pretrained

ISSUED = (0.7, 0.4)
"""Instructions a cycle of one warp alone: best and worst that is assumed."""

GATHERED = 800
"""Cycles of a step that wait for the map, where there is one."""

CARDS = {"H200 (sm_90)": ("sm_90", 132, 1.98), "Orin AGX (sm_87)": ("sm_87", 16, 1.3)}
"""Architecture, multiprocessors, clock [GHz]."""

BRANCH = 0x147


def sections(cubin: bytes) -> dict[str, bytes]:
    """Machine code of each kernel (ELF)."""
    (at,), (count,), (names,) = (struct.unpack_from(f, cubin, o) for f, o in (("<Q", 40), ("<H", 60), ("<H", 62)))
    headers = [struct.unpack_from("<IIQQQQIIQQ", cubin, at + 64 * i) for i in range(count)]
    strings = headers[names][4]
    named = {cubin[strings + h[0] :].split(b"\0")[0].decode(): cubin[h[4] : h[4] + h[5]] for h in headers}
    return {name.removeprefix(".text."): code for name, code in named.items() if name.startswith(".text.")}


def jump(low: int, high: int, architecture: str) -> int:
    """Distance of a branch from the instruction behind it [bytes]; Hopper splits it in another way."""
    if architecture == "sm_90":
        far = low >> 32
        return ((far - (far >> 31 << 32)) << 8) + (low >> 14 & 0x3FC)
    distance = (low >> 34 | (high & 0x3FFFF) << 30) << 2
    return distance - (distance >> 49 << 50)


def longest_loop(code: bytes, architecture: str) -> int:
    """Instructions between the farthest branch backwards and its target; 16 bytes each."""
    words = (struct.unpack_from("<QQ", code, place) for place in range(0, len(code), 16))
    return max(-jump(*word, architecture) // 16 for word in words if word[0] & 0x1FF == BRANCH)


def compiled(text: str, architecture: str) -> dict[str, tuple[int, int, int]]:
    """Registers, spilled bytes and instructions of a step of each kernel."""
    with TemporaryDirectory() as folder:
        source, cubin = Path(folder) / "kernels.cu", Path(folder) / "kernels.cubin"
        source.write_text(text)
        rounded = ["-prec-div=false", "-prec-sqrt=false"] if lanes_of(text) > 1 else []
        command = [
            "nvcc",
            "-std=c++17",
            f"-arch={architecture}",
            "-cubin",
            *rounded,
            "-Xptxas",
            "-v",
            source,
            "-o",
            cubin,
        ]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stderr
        pattern = r"entry function '(\w+)'.*?(\d+) bytes spill stores.*?Used (\d+) registers"
        loops = {name: longest_loop(code, architecture) for name, code in sections(cubin.read_bytes()).items()}
        return {n: (int(used), int(spilled), loops[n]) for n, spilled, used in re.findall(pattern, said, re.DOTALL)}


def main() -> None:
    """Compile, count, print."""
    dynamics = pretrained("proving-ground/dc").dynamics.requires_grad_(False)
    course = Course(np.array([[-20.0, 0], [20, 3]]), np.full(2, 6.0))
    layers = cost_map(on_cpu.ground(60), course, Hazards()).table
    texts = {"planning": plan_text(dynamics, layers, lanes=True), "training": recorded_text(dynamics)}
    print("| GPU | kernel | registers | spilled [bytes] | instructions a step | estimate, up to a warp a scheduler |")
    print("|---|---|---|---|---|---|")
    for card, (architecture, processors, clock) in CARDS.items():
        for text in texts.values():
            for name, (registers, spilled, loop) in compiled(text, architecture).items():
                if name == "offpiste_keep_within":
                    continue
                gathered = GATHERED if name == "offpiste_roll_out" else 0  # recorded ground needs no map
                cycles = [loop / issued + gathered for issued in ISSUED]
                low, high = (HORIZON_STEPS * each / clock / 1e6 for each in cycles)
                most = processors * 4 * 32 // (LANES if name == "offpiste_roll_out" else 1)
                estimate = f"{low:.1f} to {high:.1f} ms for up to {most}"
                print(f"| {card} | `{name}` | {registers} | {spilled} | {loop} | {estimate} |")


if __name__ == "__main__":
    main()
