"""Prints the physics as C++ and builds the compiled libraries (`src/offpiste/native/cpp`).

Without a C++ compiler the installation does without the libraries.
"""

import os
import platform
import runpy
import sys
from pathlib import Path
from types import ModuleType

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext

SOURCES = Path("src/offpiste/native/cpp")
TREE = runpy.run_path("src/offpiste/native/sources.py")
QUIET = ("-Wno-maybe-uninitialized", "-Wno-uninitialized")  # in headers of g++ for AVX-512
SETS = ("avx512", "avx2", "baseline") if platform.machine() in ("x86_64", "AMD64") else ("baseline",)


def print_physics() -> None:
    """Print the physics as C++ where that is missing or older than the Python it is printed from."""
    changed = max(path.stat().st_mtime for path in TREE["PRINTED_FROM"])
    if all(path.exists() and path.stat().st_mtime > changed for path in TREE["PRINTED"]):
        return
    for name in ("offpiste", "offpiste.core", "offpiste.dynamics", "offpiste.dynamics.kernels"):
        sys.modules[name] = ModuleType(name)  # their __init__.py import packages that are not installed yet
        sys.modules[name].__path__ = [str(Path("src", *name.split(".")))]
    runpy.run_module("offpiste.dynamics.kernels.generate", run_name="__main__")


class Build(build_ext):
    """Compiles the libraries side by side."""

    def finalize_options(self) -> None:
        super().finalize_options()
        self.parallel = self.parallel or os.cpu_count()


class AnyPython(bdist_wheel):
    """A wheel for every Python: the libraries are loaded by ctypes and know no Python."""

    def get_tag(self) -> tuple[str, str, str]:
        return "py3", "none", super().get_tag()[2]


def library(name: str) -> Extension:
    """The library for one instruction set."""
    source = str(SOURCES / f"{name}.cpp")
    return Extension(
        f"offpiste.native._{name}",
        [source],
        depends=[str(path) for path in TREE["sources"]()],
        define_macros=[("OFFPISTE_SOURCES", f'"{TREE["digest"]()}"')],
        extra_compile_args=[*TREE["FLAGS"], *QUIET],
        optional=True,
    )


print_physics()
setup(ext_modules=[library(name) for name in SETS], cmdclass={"build_ext": Build, "bdist_wheel": AnyPython})
