"""The installed package: its files, and dependencies that a robot can install; the core imports nothing else."""

import ast
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "offpiste"
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
EXTRAS = PYPROJECT["project"]["optional-dependencies"]
WITHOUT_AARCH64 = {"embreex", "mujoco"}
"""embreex has wheels for x86-64 alone; MuJoCo belongs to the simulator and has no place on a robot."""


def core_dependencies() -> list[Requirement]:
    """Dependencies without extras."""
    return [Requirement(text) for text in PYPROJECT["project"]["dependencies"]]


def test_every_kind_of_file_is_installed() -> None:
    declared = PYPROJECT["tool"]["setuptools"]["package-data"]["offpiste"]
    installed = {path for pattern in declared for path in SOURCE.glob(pattern)}
    files = {path for path in SOURCE.rglob("*") if path.is_file() and path.suffix not in {".py", ".pyc", ".so"}}
    assert files - installed == set()


def test_the_core_is_free_of_what_has_no_wheel_on_a_robot() -> None:
    core = {requirement.name for requirement in core_dependencies()}
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
    core = {canonicalize_name(requirement.name) for requirement in core_dependencies()}
    distributions = {name: {canonicalize_name(d) for d in found} for name, found in packages_distributions().items()}
    strangers = {
        f"{path.relative_to(SOURCE)}: {name}"
        for path in SOURCE.rglob("*.py")
        for name in imported_at_the_top(path) - sys.stdlib_module_names - {"offpiste"}
        if not core & distributions.get(name, set())
    }
    assert strangers == {
        "dynamics/kernels/generate.py: sympy",  # which only the installation runs
        "dynamics/kernels/tape.py: sympy",
    }


def test_extras_name_packages_and_the_tests_install_the_simulator() -> None:
    assert {Requirement(text).name for text in EXTRAS["sim"]} == WITHOUT_AARCH64
    assert "offpiste[sim]" in EXTRAS["test"]
