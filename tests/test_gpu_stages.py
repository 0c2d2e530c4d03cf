"""Stages of benchmarks/gpu.sh: what fails, takes too long or cannot be run stops nothing behind it, and says why."""

import json
import os
import re
import subprocess
import sys
import time
import zipfile
from argparse import Namespace
from importlib import metadata
from pathlib import Path

import pytest
import torch

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def stages(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import gpu_stages

    return gpu_stages


def test_wheels_for_a_computer_without_network_are_all_that_the_script_imports():
    script = (BENCHMARKS / "gpu_wheels.sh").read_text()
    lists = {name: re.search(rf"^{name}=\(([^)]*)\)", script, re.MULTILINE)[1] for name in ("there", "packages")}
    brought = {plain(re.split("=", name)[0]) for names in lists.values() for name in names.split()}
    brought |= {plain(needed) for name in lists["there"].split() for needed in needs_of(name)}
    text = "import sys, gpu; print(*sys.modules)"
    paths = {
        "PYTHONPATH": os.pathsep.join(
            (str(BENCHMARKS), str(BENCHMARKS.parent / "tests"), os.environ.get("PYTHONPATH", ""))
        )
    }
    done = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, check=True, env=os.environ | paths
    )
    imported = owners_of(done.stdout.split())
    assert {"torch", "mcap"} <= imported
    may_be_there = {"offpiste", "setuptools", "charset-normalizer"}  # the last is read by numpy.f2py where it is there
    assert imported - brought - may_be_there == set()


def plain(name):
    return re.sub("[-_.]+", "-", name).lower()


def owners_of(modules):
    """Packages of modules; where several share a first name (`backports`), those that a module is named after."""
    found, whole = set(), {plain(name) for name in modules}
    by_first_name = metadata.packages_distributions()
    for first in {name.partition(".")[0] for name in modules}:
        owners = {plain(owner) for owner in by_first_name.get(first, [])}
        found |= (owners & whole or owners) if len(owners) > 1 else owners
    return found


def needs_of(name, known=()):
    """What a package that is installed here requires, in turn."""
    try:
        lines = metadata.requires(name) or []
    except metadata.PackageNotFoundError:
        return set()
    found = {re.match(r"[\w.-]+", line)[0] for line in lines if "extra ==" not in line} - set(known)
    return found.union(*(needs_of(each, {*known, *found}) for each in found))


def by_python(text):
    return lambda folder, given: [sys.executable, "-c", text, str(folder)]


WRITES = "import sys, pathlib; (pathlib.Path(sys.argv[1]) / '{}.json').write_text('[{{\"what\": \"first row\"}}]');"


def test_rows_before_a_failure_are_kept_with_its_reason(stages, tmp_path):
    text = WRITES.format("plans") + "print('a'); raise SystemExit('kernels differ')"
    result = stages.run(stages.Stage("plans", 60, by_python(text)), tmp_path, Namespace(), 60)
    assert result["rows"] == [{"what": "first row"}]
    assert result["failed"] == "exit code 1: kernels differ (see plans.log)"
    assert (tmp_path / "plans.log").read_text() == "a\nkernels differ\n"
    assert "| plans | failed: exit code 1: kernels differ (see plans.log) | | |" in stages.table([result])


def test_a_stage_that_hangs_ends_with_its_children_and_one_without_time_is_not_begun(stages, tmp_path):
    sleeps = "import subprocess; subprocess.run(['sleep', '60'])"
    began = time.monotonic()
    result = stages.run(stages.Stage("plans", 1, by_python(sleeps)), tmp_path, Namespace(), 60)
    assert time.monotonic() - began < 30
    assert result["failed"] == "stopped after 1 s (see plans.log)"
    assert stages.run(stages.Stage("plans", 1, by_python(sleeps)), tmp_path, Namespace(), 0.5)["skipped"]


def test_a_stage_that_lacks_a_tool_says_which(stages, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("MPPI_GENERIC", str(tmp_path / "sources"))
    given = Namespace(device="cpu", small=True)
    wanted = ("example", "memcheck", "mppi-generic")
    chosen = [stage for stage in stages.STAGES if stage.name in wanted]
    skipped = {stage.name: stages.run(stage, tmp_path, given, 60) for stage in chosen}
    assert skipped["example"]["skipped"] == "nvcc is not there"
    assert skipped["memcheck"]["skipped"] == "compute-sanitizer is not there"
    assert skipped["mppi-generic"]["skipped"] == f"{tmp_path}/sources/include is not there; set MPPI_GENERIC"
    assert json.dumps(list(skipped.values()))


def test_memcheck_sees_each_array_as_an_allocation_of_its_own(stages, tmp_path):
    text = "import os; print(os.environ.get('PYTORCH_NO_CUDA_MEMORY_CACHING'))"
    said = {name: stages.run(stages.Stage(name, 60, by_python(text)), tmp_path, Namespace(), 60)["said"]
            for name in ("memcheck", "example")}  # fmt: skip
    assert said["memcheck"] == "1"
    assert said["example"] != "1"


@pytest.mark.skipif(torch.cuda.is_available(), reason="a GPU is here")
def test_without_a_gpu_it_is_one_line(tmp_path):
    done = subprocess.run(
        ["bash", str(BENCHMARKS / "gpu.sh"), str(tmp_path)], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.startswith("no stage was run: exit code 1: no GPU 'cuda': torch ")
    assert done.stderr.count("\n") == 1


def test_wheels_of_a_folder_are_there_for_the_run_alone(tmp_path):
    wheels, about = tmp_path / "wheels", "only_there-1.0.dist-info"
    wheels.mkdir()
    with zipfile.ZipFile(wheels / "only_there-1.0-py3-none-any.whl", "w") as wheel:
        wheel.writestr("only_there.py", "HERE = 'found'")
        wheel.writestr(f"{about}/METADATA", "Metadata-Version: 2.1\nName: only_there\nVersion: 1.0\n")
        wheel.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        wheel.writestr(f"{about}/RECORD", "")
    python = tmp_path / "python"
    prints = f'exec "{sys.executable}" -c "import only_there; print(only_there.HERE, only_there.__file__)"'
    python.write_text(f'#!/bin/sh\n[ "$1" = -m ] && exec "{sys.executable}" "$@"\n{prints}\n')
    python.chmod(0o755)

    def run(**more):
        given = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"} | more
        return subprocess.run(["bash", str(BENCHMARKS / "gpu.sh")], capture_output=True, text=True, env=given)

    found, place = run(WHEELS=str(wheels)).stdout.split()
    assert found == "found"
    assert not Path(place).exists()
    assert run().returncode == 1, "without them"
    assert run(WHEELS=str(tmp_path / "none")).stdout == "", "nothing is run where they cannot be installed"
