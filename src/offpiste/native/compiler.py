"""Planning code with cost terms that do not ship, compiled on first use and kept in the user's cache folder."""

import ctypes
import hashlib
import logging
import os
import shutil
import subprocess
import tempfile
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Final

from offpiste.core.cache import cache_folder
from offpiste.native.library import instruction_set, library
from offpiste.native.sources import FLAGS, digest

logger = logging.getLogger(__name__)

LONGEST: Final = 300.0
"""Longest time for a compilation [s]."""


@cache
def planning_library(costs: str) -> ctypes.CDLL | None:
    """Return the library whose plans have these costs; None where there is no C++ compiler.

    Args:
        costs: C code of the terms (`planning.costs.text.terms_text`).
    """
    if costs == source_text("costs.h"):
        return library()
    key = hashlib.sha256("\0".join((costs, instruction_set(), digest())).encode()).hexdigest()
    path = cache_folder() / "costs" / f"{key[:32]}.so"
    try:
        if not path.exists():
            _compile(costs, path)
        return ctypes.CDLL(str(path))
    except (OSError, subprocess.SubprocessError) as error:
        lines = str(getattr(error, "stderr", None) or error).strip().splitlines()
        reason = next((line for line in lines if "error" in line), lines[0])
        logger.warning(f"added cost terms cannot be compiled; plans run eagerly, about 50 times slower: {reason}")
        return None


def source_text(name: str) -> str:
    """Return the text of a source file of the library."""
    return files("offpiste.native").joinpath("cpp", name).read_text("utf-8")


def _compile(costs: str, path: Path) -> None:
    compiler = next(filter(None, map(shutil.which, (os.environ.get("CXX", ""), "c++", "g++", "clang++"))), None)
    if compiler is None:
        raise OSError("no C++ compiler; install g++")
    logger.info("compiling the added cost terms once, about 10 s")
    source = Path(str(files("offpiste.native").joinpath("cpp", f"{instruction_set()}.cpp")))
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        terms, built = Path(folder, "costs.h"), Path(folder, "plan.so")
        terms.write_text(costs)
        defined = (f'-DOFFPISTE_COSTS="{terms}"', "-DOFFPISTE_PLAN_ONLY")
        command = [compiler, *FLAGS, "-shared", "-fPIC", "-w", *defined, str(source), "-o", str(built)]
        subprocess.run(command, check=True, capture_output=True, text=True, timeout=LONGEST)
        built.replace(path)  # at once, as another process may do the same
