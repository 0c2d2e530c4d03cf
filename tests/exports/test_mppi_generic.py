"""Exports for MPPI-Generic, compiled by g++ with a stand-in for that library, Eigen and CUDA (`stand_in/`)."""

import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from exports.test_c_files import compiled_and_run, write_example
from host_kernels import needs_gcc
from offpiste.exports.formats import export
from offpiste.exports.parity import parity_bytes

STAND_IN = Path(__file__).parent / "stand_in"

pytestmark = needs_gcc


def driven(folder, source="drive.cu"):
    flags = ("-std=c++17", "-O0", "-Wall", "-Wno-unused-function", "-Werror", "-I", str(STAND_IN), "-I", str(folder))
    return compiled_and_run(folder, "g++", *flags, "-x", "c++", str(source))


def test_the_exported_dynamics_drives_5_s_and_agrees_with_predictions(tmp_path):
    export("pretrained:proving-ground/dc", tmp_path / "out", "mppi-generic")
    ran = driven(tmp_path / "out")
    assert ran.returncode == 0, ran.stdout
    assert float(ran.stdout.split("at most ")[1].split()[0]) < 2e-4
    readme = (tmp_path / "out" / "README.md").read_text()
    for name in ("offpiste_dynamics.cuh", "offpiste_cost.cuh", "drive.cu", "planner.cu", "parity.bin"):
        assert (tmp_path / "out" / name).is_file()
        assert name in readme


@pytest.mark.parametrize("kind", ["gear without throttle", "features"])
def test_every_kind_of_model_drives_on_the_host_and_as_a_gpu_would(kind, tmp_path):
    names = ("offpiste_dynamics.cuh", "offpiste_cost.cuh", "drive.cu", "parity.h")
    case = write_example(kind, tmp_path, names, drives=4, steps=60)
    ran = driven(tmp_path)
    assert ran.returncode == 0, ran.stdout
    (tmp_path / "parity.bin").write_bytes(parity_bytes(replace(case, expected=case.expected + 0.01)))
    assert subprocess.run(["./example"], cwd=tmp_path, capture_output=True).returncode == 1
    device = driven(tmp_path, STAND_IN / "device.cu").stdout.split()
    assert device[:6] == ["refused", "1", "taken", "1", "within", "1"]
    assert float(device[7]) < 1e-5
