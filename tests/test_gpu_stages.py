"""benchmarks/gpu.sh on a computer without a GPU or without network."""

import os
import re
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
import torch

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


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


@pytest.mark.skipif(torch.cuda.is_available(), reason="a GPU is here")
def test_without_a_gpu_it_is_one_line(tmp_path):
    done = subprocess.run(
        ["bash", str(BENCHMARKS / "gpu.sh"), str(tmp_path)], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.startswith("no stage was run: no GPU 'cuda': torch ")
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
        return subprocess.run(
            ["bash", str(BENCHMARKS / "gpu.sh"), str(tmp_path / "out"), "no-stage"],
            capture_output=True,
            text=True,
            env=given,
        )

    found, place = run(WHEELS=str(wheels)).stdout.split()[:2]
    assert found == "found"
    assert not Path(place).exists()
    assert run().returncode == 1, "without them"
    assert run(WHEELS=str(tmp_path / "none")).stdout == "", "nothing is run where they cannot be installed"
