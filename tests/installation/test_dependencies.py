"""Dependencies on a robot: the core needs only packages with wheels, and imports nothing else."""

import ast
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from installation import wheels

SOURCE = wheels.PYPROJECT.parent / "src" / "offpiste"
WITHOUT_AARCH64 = {"embreex", "mujoco"}
"""embreex has wheels for x86-64 alone; MuJoCo belongs to the simulator and has no place on a robot."""


def test_the_core_is_free_of_what_has_no_wheel_on_a_robot() -> None:
    core = {requirement.name for requirement in wheels.core_dependencies()}
    assert {"torch", "numpy", "rosbags"} <= core
    assert not core & WITHOUT_AARCH64
    assert "opencv-python-headless" in core, "headless: a robot has no display"
    assert "opencv-python" not in core


def imported_at_the_top(path: Path) -> set[str]:
    """Modules that a file imports outside of functions, `with extra(...)` and `if TYPE_CHECKING`."""
    names: set[str] = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        if isinstance(node, ast.ImportFrom) and not node.level:
            names.add((node.module or "").split(".")[0])
    return names


def test_every_module_imports_only_core_dependencies_at_its_top() -> None:
    core = {canonicalize_name(requirement.name) for requirement in wheels.core_dependencies()}
    distributions = {name: {canonicalize_name(d) for d in found} for name, found in packages_distributions().items()}
    strangers = {
        f"{path.relative_to(SOURCE)}: {name}"
        for path in SOURCE.rglob("*.py")
        for name in imported_at_the_top(path) - sys.stdlib_module_names - {"offpiste"}
        if not core & distributions.get(name, set())
    }
    assert strangers == {
        "dynamics/kernels/generate.py: sympy",  # which only who changes the physics runs
        "dynamics/kernels/tape.py: sympy",
    }


def test_extras_name_packages_and_the_tests_install_the_simulator() -> None:
    extras = tomllib.loads(wheels.PYPROJECT.read_text())["project"]["optional-dependencies"]
    assert {Requirement(text).name for text in extras["sim"]} == WITHOUT_AARCH64
    assert "offpiste[sim]" in extras["test"]
