"""Forty cases of a new seed every day, and what the fuzzer itself must do."""

import datetime
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.fuzz.cases import verdict_of
from tests.fuzz.isolation import MEMORY, Outcome, run_apart
from tests.fuzz.mutations import BYTES, TEXT, mutate_values

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


@pytest.mark.parametrize("mutation", [*dict.fromkeys(BYTES)], ids=lambda m: m.__name__)
@pytest.mark.parametrize("data", [b"", b"x", bytes(range(256)) * 20])
def test_mutations_of_bytes_follow_from_the_seed(mutation, data: bytes) -> None:
    first, again = (mutation(data, np.random.default_rng(3)) for _ in range(2))
    assert first == again
    if len(data) > 1:
        assert any(mutation(data, np.random.default_rng(seed)) != data for seed in range(20))


@pytest.mark.parametrize("mutation", [*dict.fromkeys(TEXT)], ids=lambda m: m.__name__)
@pytest.mark.parametrize("text", ["", "x", 'a = 1\nb = "two"\nc = [3.5, -4]\n'])
def test_mutations_of_text_follow_from_the_seed(mutation, text: str) -> None:
    first, again = (mutation(text, np.random.default_rng(3)) for _ in range(2))
    assert first == again
    if len(text) > 1:
        assert any(mutation(text, np.random.default_rng(seed)) != text for seed in range(20))


@pytest.mark.parametrize("kind", ["<f8", "<f4", "<f2", "<i4", "<u2", "?"])
def test_mutations_of_values_keep_type_and_shape(kind: str) -> None:
    values = np.ones((50, 3), kind)
    for seed in range(30):
        changed, how = mutate_values(values, np.random.default_rng(seed))
        assert (changed.dtype, changed.shape) == (values.dtype, values.shape), how


def outcome(code: int, err: str = "", out: str = "", **changed: object) -> Outcome:
    return Outcome(**{"code": code, "hung": False, "seconds": 1.0, "memory": 1 << 20, "out": out, "err": err} | changed)


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
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
    ],
)
def test_verdicts(found: Outcome, verdict: str) -> None:
    assert verdict_of(found)[0] == verdict


@pytest.mark.parametrize(
    ("report", "verdict"),
    [
        ("run: lacks a file; restore it\nrun/model.json: is damaged; restore it\n", "refused"),
        ("run: lacks a file; restore it\nfailed\n", "wrong message"),
        ("", "wrong message"),
    ],
)
def test_verdicts_on_the_report_of_check(report: str, verdict: str) -> None:
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
        (partial(_allocate, 5 << 30), "memory"),
        (partial(_allocate, 1 << 50), "memory"),
        (partial(os.abort), "killed"),
    ],
)
def test_a_process_of_its_own_ends_as_it_ends(tmp_path: Path, work, verdict: str) -> None:
    assert verdict_of(run_apart(work, tmp_path))[0] == verdict
