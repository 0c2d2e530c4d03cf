"""A process that compiles the kernels and one that loads them from the cache plan and drive with the same bits."""

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = """
import hashlib
import numpy as np
from planning import test_kernel as kernel
from runtime.stream import straight_drive

def digest(*arrays):
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()

at, dynamics = kernel.situation(kernel.ground(), state=(-3.0, 1, 0.3, 8, 0.2, 0.1)), kernel.model("dc")
codes = kernel.encode_map(at.ground, dynamics.encoder)
costs, states = kernel.fused_rollout(
    dynamics, kernel.start(dynamics, at), kernel.commands(33), at, kernel.CostWeights(), codes
)
print("rollouts", digest(costs, states))
drive = straight_drive(dynamics=kernel.model("b"))
print("controls", digest(*(controls.command for controls in drive.run(0.5))))
"""


def test_compiling_and_loading_give_the_same_bits(tmp_path):
    tests = str(Path(__file__).parents[1])
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join((tests, os.environ.get("PYTHONPATH", ""))),
        "NUMBA_CACHE_DIR": str(tmp_path),
    }

    def printed():
        return subprocess.run(
            [sys.executable, "-c", PROGRAM], env=environment, check=True, capture_output=True, text=True
        ).stdout

    compiled = printed()
    cached = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nbc")}
    assert any("roll_out" in file.name for file in cached)
    assert printed() == compiled
    assert {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nbc")} == cached, "the second process loads"
