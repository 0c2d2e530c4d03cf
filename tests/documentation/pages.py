"""Code blocks of a page of docs/, run in order, and comparison of their output with the page."""

import contextlib
import io
import logging
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+(?:\.\d+)?")
TOLERANCE = 0.2
SMALL = 100
"""Whole numbers below this have to be the same."""


@dataclass(frozen=True)
class Step:
    """A block of code, and the output that the page shows below it; None where it shows none."""

    language: str
    code: str
    line: int
    shown: str | None


def steps_of(text: str) -> list[Step]:
    """The steps of a page: blocks of `sh` and `python`, each with the block of `text` that follows, if one does."""
    blocks, steps = list(BLOCK.finditer(text)), []
    for block, following in zip(blocks, [*blocks[1:], None], strict=True):
        if block.group(1) in ("sh", "python"):
            has_output = following is not None and following.group(1) == "text"
            shown = following.group(2) if following is not None and has_output else None
            steps.append(Step(block.group(1), block.group(2), text[: block.start()].count("\n") + 1, shown))
    return steps


def run_page(page: Path, folder: Path) -> list[tuple[Step, str]]:
    """Run a page's steps in the current folder, Python in one namespace; each with what it printed.

    Args:
        folder: for a command `offpiste`.
    """
    command = folder / "offpiste"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m offpiste "$@"\n')
    command.chmod(0o755)
    path = os.pathsep.join(map(str, (folder, os.environ["PATH"])))
    environment = {**os.environ, "PATH": path, "COLUMNS": "120", "NO_COLOR": "1"}
    # Commands find offpiste where this process does.
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    namespace, done = {"__name__": "__main__"}, []
    with silent_library():
        for step in steps_of(page.read_text("utf-8")):
            if step.language == "sh":
                shell = ["bash", "-ec", step.code]
                ran = subprocess.run(
                    shell, env=environment, stdout=-1, stderr=subprocess.STDOUT, text=True, check=False
                )
                assert ran.returncode == 0, f"{page.name}:{step.line}: {ran.stdout}"
                done.append((step, ran.stdout))
            else:
                printed = io.StringIO()
                with contextlib.redirect_stdout(printed):
                    exec(compile("\n" * step.line + step.code, str(page), "exec"), namespace)
                done.append((step, printed.getvalue()))
    return done


@contextlib.contextmanager
def silent_library() -> Iterator[None]:
    """offpiste as it is in a new process: it logs nothing, whatever ran in this one before."""
    logger = logging.getLogger("offpiste")
    handlers, logger.handlers = logger.handlers, []
    try:
        yield
    finally:
        logger.handlers = handlers


def difference(shown: str, printed: str) -> str:
    """First line of what a page shows that was not printed in this place, "" if none (numbers: `near`).

    A line `…` stands for any lines.
    """
    lines, skipping = iter([line.split() for line in printed.splitlines() if line.strip()]), False
    for expected in (line for line in shown.splitlines() if line.strip()):
        if expected.strip() == "…":
            skipping = True
            continue
        if skipping:
            found = any(alike(expected.split(), line) for line in lines)
        else:
            found = alike(expected.split(), next(lines, []))
        if not found:
            return expected
        skipping = False
    return "" if skipping else " ".join(next(lines, []))


def alike(expected: list[str], words: list[str]) -> bool:
    """Return whether two lines have the same words and nearly the same numbers."""
    one, other = " ".join(expected), " ".join(words)
    if NUMBER.sub("#", one) != NUMBER.sub("#", other):
        return False
    pairs = zip(NUMBER.findall(one), NUMBER.findall(other), strict=True)
    return all(near(a.replace("−", "-"), b.replace("−", "-")) for a, b in pairs)


def near(shown: str, printed: str) -> bool:
    """Return whether two numbers differ by at most a fifth or 0.05; small integers must be equal."""
    a, b = float(shown), float(printed)
    if "." not in shown and a < SMALL:
        return a == b
    return abs(a - b) <= max(TOLERANCE * max(abs(a), abs(b)), 0.05)
