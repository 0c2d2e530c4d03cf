"""Reports whether every core dependency, and what it depends on, has a wheel for Linux on x86-64 and aarch64.

`python tests/installation/wheels.py` asks the package index through pip, which resolves but installs nothing; a minute.
"""

import json
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from packaging.requirements import Requirement

PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"
MACHINES = ("x86_64", "aarch64")
PYTHON = "3.11"
GLIBC = range(28, 16, -1)
"""Minor versions of glibc 2 whose wheels run on a robot: Ubuntu 20.04 has 2.31."""


def core_dependencies() -> list[Requirement]:
    """What `pip install offpiste` without extras asks for."""
    return [Requirement(text) for text in tomllib.loads(PYPROJECT.read_text())["project"]["dependencies"]]


def find_wheel(requirement: Requirement, machine: str) -> dict[str, Any] | None:
    """pip's report of the wheel that it would install; None where there is none."""
    platforms = [f"manylinux2014_{machine}", *(f"manylinux_2_{minor}_{machine}" for minor in GLIBC)]
    with TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pip", "install", "--dry-run", "--quiet", "--ignore-installed", "--no-deps"]
        command += ["--target", folder, "--only-binary=:all:", "--python-version", PYTHON, "--report", "-"]
        command += [word for platform in platforms for word in ("--platform", platform)]
        bare = f"{requirement.name}{requirement.specifier}"
        done = subprocess.run([*command, bare], capture_output=True, text=True, check=False)
    return json.loads(done.stdout)["install"][0] if done.returncode == 0 else None


def resolved(machine: str) -> Iterator[tuple[Requirement, str]]:
    """Each dependency and the file name of its wheel, "" without one; dependencies of dependencies follow."""
    marks = {"platform_machine": machine, "platform_system": "Linux", "sys_platform": "linux", "extra": ""}
    marks |= {"python_version": PYTHON, "implementation_name": "cpython", "os_name": "posix"}
    waiting, seen = core_dependencies(), set()
    while waiting:
        requirement = waiting.pop(0)
        name = requirement.name.lower().replace("_", "-")
        if name in seen or (requirement.marker and not requirement.marker.evaluate(marks)):
            continue
        seen.add(name)
        wheel = find_wheel(requirement, machine)
        yield requirement, wheel["download_info"]["url"].rsplit("/", 1)[-1] if wheel else ""
        waiting += [Requirement(text) for text in (wheel or {"metadata": {}})["metadata"].get("requires_dist", [])]


def main() -> int:
    """Print a line a dependency; exit code 1 if one lacks a wheel."""
    missing = 0
    for machine in MACHINES:
        print(f"{machine}, Python {PYTHON}")
        for requirement, wheel in resolved(machine):
            print(f"  {requirement!s:45.45} {wheel or 'NO WHEEL'}", flush=True)
            missing += not wheel
    print(f"{missing} without a wheel")
    return int(missing > 0)


if __name__ == "__main__":
    sys.exit(main())
