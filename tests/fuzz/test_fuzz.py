"""Fuzzing with a new seed every day, and tests of the fuzzer itself."""

import datetime
import itertools
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.fuzz.cases import verdict_of
from tests.fuzz.isolation import MEMORY, Outcome, run_apart
from tests.fuzz.mutations import BYTES, TEXT

SEED = int(os.environ.get("OFFPISTE_FUZZ_SEED") or datetime.date.today().toordinal())


def test_forty_cases_of_a_new_seed(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.fuzz", "--cases", "40", "--seed", str(SEED), "--out", "cases.jsonl"]
    root = Path(__file__).parents[2]
    command[-1] = str(tmp_path / "cases.jsonl")
    path = os.pathsep.join((str(root), *filter(None, sys.path)))  # the offpiste whose kernels may be compiled already
    done = subprocess.run(
        command, cwd=root, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"OFFPISTE_FUZZ_SEED={SEED} repeats it\n{done.stdout}\n{done.stderr}"
    assert "40 cases" in done.stdout


@pytest.mark.parametrize(
    ("mutations", "inputs"),
    [(BYTES, (b"", b"x", bytes(range(256)) * 20)), (TEXT, ("", "x", 'a = 1\nb = "two"\nc = [3.5, -4]\n'))],
    ids=["bytes", "text"],
)
def test_mutations_follow_from_the_seed(mutations, inputs) -> None:
    for mutation, given in itertools.product({*mutations}, inputs):
        first, again = (mutation(given, np.random.default_rng(3)) for _ in range(2))
        assert first == again
        assert len(given) < 2 or any(mutation(given, np.random.default_rng(seed)) != given for seed in range(20))


def outcome(code: int, err: str = "", out: str = "", **changed: object) -> Outcome:
    return Outcome(**{"code": code, "hung": False, "seconds": 1.0, "memory": 1 << 20, "out": out, "err": err} | changed)


def test_verdicts() -> None:
    for found, verdict in (
        (outcome(0), "ok"),
        (outcome(1, "offpiste: drive.csv: no row below the header; export it again\n"), "refused"),
        (outcome(1, out="NOT usable for training (1 fatal)"), "refused"),
        (outcome(1), "wrong message"),
        (outcome(1, "offpiste: failed\n"), "wrong message"),
        (outcome(1, "offpiste: a.csv: bad; fix it\noffpiste: again: bad; fix it\n"), "wrong message"),
        (outcome(1, "x.py:1: RuntimeWarning: overflow\noffpiste: a.csv: bad; fix it\n"), "wrong message"),
        (outcome(70, "Traceback (most recent call last):\nKeyError: 'x'\n"), "traceback"),
        (outcome(71, "MemoryError\n"), "memory"),
        (outcome(0, memory=MEMORY + 1), "memory"),
        (outcome(-11), "killed"),
        (outcome(-9, hung=True), "hang"),
    ):
        assert verdict_of(found)[0] == verdict
    for report, verdict in (
        ("run: lacks a file; restore it\nrun/model.json: is damaged; restore it\n", "refused"),
        ("run: lacks a file; restore it\nfailed\n", "wrong message"),
        ("", "wrong message"),
    ):
        assert verdict_of(outcome(1, out=report), "check")[0] == verdict
        assert verdict_of(outcome(1, out=report), "train")[0] == "wrong message"


def _allocate(size: int) -> None:
    np.ones(size, np.uint8)


@pytest.mark.parametrize(
    ("work", "verdict"),
    [
        (partial(print, "done"), "ok"),
        (partial(sys.exit, 3), "wrong message"),
        (partial(int, "x"), "traceback"),
        (partial(_allocate, 3 << 30), "memory"),
        (partial(os.abort), "killed"),
    ],
)
def test_the_end_of_a_process_gives_the_verdict(tmp_path: Path, work, verdict: str) -> None:
    assert verdict_of(run_apart(work, tmp_path))[0] == verdict
