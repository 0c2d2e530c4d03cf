"""Cache of machine code, in processes of their own because Numba chooses its folder once."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from offpiste.native import kernel_cache

CODE = """
import logging, sys
logging.basicConfig(level=logging.INFO, format="%(message)s")
sys.path.insert(0, sys.argv[1])
import called
print(called.double(3.0))
"""
MODULE = """
from offpiste.native.compilation import Compiler

COMPILER = Compiler((), part="the doubling", seconds=7)

@COMPILER.entry
def double(x):
    return x + x

@COMPILER.entry
def triple(x):
    return x + x + x

triple(1.0)
"""
WAITS = "compiling the doubling once, about 7 s; `offpiste warm-up` does it ahead\n"


@pytest.fixture
def module(tmp_path: Path) -> Path:
    folder = tmp_path / "module"
    folder.mkdir()
    (folder / "called.py").write_text(MODULE)
    return folder


def environment(cache: Path) -> dict[str, str]:
    """Environment of a process with that cache."""
    others = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA")}
    return others | {"OFFPISTE_CACHE": str(cache), "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def called(module: Path, cache: Path) -> str:
    """Log of a process that calls the entries."""
    done = subprocess.run(
        [sys.executable, "-c", CODE, str(module)], env=environment(cache), capture_output=True, text=True, check=True
    )
    assert done.stdout == "6.0\n"
    return done.stderr


SLOW = """
import time
from offpiste.native.compilation import SelfContained

passes = SelfContained.define_pipelines

def late(self):
    open(sys.argv[2], "w").close()
    time.sleep(2)
    return passes(self)

SelfContained.define_pipelines = late
"""


def begun(module: Path, cache: Path, code: str, *more: Path) -> subprocess.Popen[str]:
    """A process that calls the entries."""
    return subprocess.Popen(
        [sys.executable, "-c", code, str(module), *map(str, more)],
        env=environment(cache), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def compiling(module: Path, cache: Path, mark: Path) -> subprocess.Popen[str]:
    """A process that has begun to compile, for two seconds."""
    process = begun(module, cache, CODE.replace("import called", SLOW + "import called"), mark)
    while not mark.exists():
        assert process.poll() is None
        time.sleep(0.02)
    return process


def test_a_process_waits_for_another_one_that_compiles_the_same(module: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    first = compiling(module, cache, tmp_path / "compiles")
    (out, said), (_, said_first) = begun(module, cache, CODE).communicate(timeout=60), first.communicate(timeout=60)
    assert (out, said) == ("6.0\n", "waiting for another process, which compiles the doubling\n" * said.count("\n"))
    assert said
    assert said_first == WAITS


def test_a_process_that_is_killed_while_it_compiles_keeps_no_other_from_it(module: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    first = compiling(module, cache, tmp_path / "compiles")
    first.kill()
    first.communicate()
    assert called(module, cache) == WAITS


def test_compilation_is_announced_and_cached_and_damaged_code_is_compiled_again(module: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert called(module, cache) == WAITS  # once, not for each entry
    assert len(list((cache / "kernels").rglob("*.nbc"))) == 2
    assert not list(module.rglob("*.nbc"))
    for ending, content in (("*.nbc", b"\x80"), ("*.nbi", b"no pickle")):
        for kept in cache.rglob(ending):
            kept.write_bytes(content)
        said = called(module, cache)
        assert said.count("cannot be used and is compiled again") == 2
        assert WAITS in said
    assert called(module, cache) == ""


def test_a_folder_that_cannot_be_made_is_done_without(module: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    assert called(module, tmp_path / "file") == WAITS
    assert list(module.rglob("*.nbc")), "beside the sources, which can be written here"


def test_a_compilation_that_fails_keeps_no_other_process_from_it(module: Path, tmp_path: Path) -> None:
    """The process that failed lives on."""
    cache = tmp_path / "cache"
    fails = SLOW.replace("time.sleep(2)\n    return passes(self)", "raise KeyboardInterrupt")
    lives_on = CODE.replace("import called", fails + "try:\n    import called\nexcept KeyboardInterrupt:\n    pass")
    lives_on = lives_on.replace("print(called.double(3.0))", "print('failed', flush=True); sys.stdin.read()")
    first = subprocess.Popen(
        [sys.executable, "-c", lives_on, str(module), str(tmp_path / "compiles")],
        env=environment(cache), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert first.stdout is not None
    assert first.stdout.readline() == "failed\n"
    assert called(module, cache) == WAITS
    first.communicate()


def test_without_a_place_for_the_code_no_process_waits(tmp_path: Path) -> None:
    class Machine:
        def codegen(self) -> "Machine":
            return self

        def magic_tuple(self) -> tuple[str]:
            return ("machine",)

    first, other = (kernel_cache._Lock(tmp_path, "kernel", "") for _ in range(2))
    first.acquire(Machine())
    first.give_up()
    began = time.monotonic()
    other.acquire(Machine())
    assert time.monotonic() - began < 5
    for lock in (first, other):
        lock.release()
