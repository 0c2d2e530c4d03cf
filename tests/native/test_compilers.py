"""The library by another compiler and for another processor: Clang and system libraries of the package `ziglang`."""

import ctypes
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from offpiste.native import library, sources, tensors
from offpiste.planning.noise import coloured

pytest.importorskip("ziglang")


def built(name: str, target: str, out: Path) -> Path:
    source = sources.PACKAGE / "native" / "cpp" / f"{name}.cpp"
    defined = f'-DOFFPISTE_SOURCES="{sources.digest()}"'
    clang = [sys.executable, "-m", "ziglang", "c++", "-target", target]
    command = [*clang, *sources.FLAGS, "-Werror", defined, "-shared", "-fPIC", str(source), "-o", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr[:3000]
    return out


def test_it_is_compiled_for_aarch64(tmp_path):
    header = built("baseline", "aarch64-linux-gnu", tmp_path / "arm.so").read_bytes()[:20]
    assert (header[:4], int.from_bytes(header[18:20], "little")) == (b"\x7fELF", 183), "EM_AARCH64"


def test_clang_and_gcc_compute_the_same(tmp_path, monkeypatch):
    name = library.instruction_set()
    loaded = ctypes.CDLL(str(built(name, "x86_64-linux-gnu", tmp_path / "clang.so")))
    shape = (65, 30, 3)
    wanted = coloured(shape, torch.Generator().manual_seed(1))
    monkeypatch.setattr(tensors, "library", lambda: loaded)
    found = coloured(shape, torch.Generator().manual_seed(1))
    assert not torch.equal(found, torch.zeros(shape))
    np.testing.assert_allclose(found, wanted, atol=4e-6)
