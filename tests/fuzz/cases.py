"""Fuzzing cases: a mutated input, a command that reads it, and a verdict."""

import json
import re
import shutil
import signal
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from tests.fuzz.corpus import Sound, run_command
from tests.fuzz.isolation import MEMORY, OUT_OF_MEMORY, TRACEBACK, Outcome, run_isolated
from tests.fuzz.mutations import Generator, mutate_bytes, mutate_text

TEXTS = {".toml", ".txt", ".csv", ".json", ".yaml"}
GOOD = ("ok", "refused")
"""Accepted verdicts."""
LONGEST_LINE = 700
"""Longest message [characters]."""


@dataclass(frozen=True)
class Case:
    """Result of a case.

    Attributes:
        mutation: description of the mutation.
        verdict: ok, refused, traceback, hang, memory, killed, or wrong message.
        why: message, or last line of a traceback.
        memory: largest resident memory [MB].
    """

    case: int
    seed: int
    kind: str
    source: str
    command: str
    mutation: str
    verdict: str
    why: str
    seconds: float
    memory: int

    def as_line(self) -> str:
        return json.dumps(asdict(self))


def run_case(number: int, seed: int, corpus: Sequence[Sound], folder: Path) -> Case:
    """Build the input of a case in a folder, and run its command."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    rng = np.random.default_rng([seed, number])
    sound = _chosen(corpus, rng)
    command = sound.commands[int(rng.integers(len(sound.commands)))]
    (folder / "input").mkdir()
    copy = folder / "input" / sound.files.name
    made = run_isolated(partial(_mutate, sound, copy, rng), folder)
    mutation = made.out.strip().splitlines()[-1] if made.out.strip() else ""
    if made.code:
        raise RuntimeError(f"case {number}: the input could not be made\n{made.err}")
    (folder / "out").mkdir()
    given = copy / sound.input if sound.input else copy
    outcome = run_isolated(partial(_run, command, given, folder), folder)
    verdict, why = verdict_of(outcome, command.split()[0])
    return Case(
        number, seed, sound.kind, sound.files.name, command.split()[0], mutation, verdict, why,
        round(outcome.seconds, 2), outcome.memory >> 20,
    )  # fmt: skip


def _chosen(corpus: Sequence[Sound], rng: Generator) -> Sound:
    """Choose an input; cases without recorded drives are the same if there are none."""
    made, recorded = ([sound for sound in corpus if sound.recorded == which] for which in (False, True))
    shares = np.array([sound.share for sound in made])
    sound, instead, which = made[int(rng.choice(len(made), p=shares / shares.sum()))], rng.random() < 0.1, rng.random()
    return recorded[int(which * len(recorded))] if recorded and instead else sound


def _run(command: str, given: Path, folder: Path) -> None:
    (folder / "command.txt").write_text(f"offpiste {command.format(input=given, out=folder / 'out')}\n")
    if command.startswith(("simulate", "drive")):
        _small_worlds()
    run_command(command, input=given, out=folder / "out")


def _small_worlds() -> None:
    """Use small worlds, because worlds take seconds to make and their size is not an option."""
    from offpiste.simulation.world.world import WorldSettings

    WorldSettings.__init__.__defaults__ = (*WorldSettings.__init__.__defaults__[:-2], 120.0, 1.0)


def _mutate(sound: Sound, copy: Path, rng: Generator) -> None:
    """Copy and mutate the input, mostly with new checksums, and print the mutation."""
    shutil.copytree(sound.files, copy) if sound.files.is_dir() else shutil.copy(sound.files, copy)
    sealed = sound.seal is not None and rng.random() < 0.7
    how = _mutated(sound, copy, rng)
    if sealed and sound.seal is not None and how != "none":
        sound.seal(copy)
    print(f"{how}, sealed" if sealed else how)


def _mutated(sound: Sound, copy: Path, rng: Generator) -> str:
    if rng.random() < 0.02:
        return "none"
    if sound.rewrite is not None and rng.random() < 0.45:
        return f"rewritten: {sound.rewrite(copy, rng)}"
    files = sorted(p for p in copy.rglob("*") if p.is_file()) if copy.is_dir() else [copy]
    # Folders are equally likely, whatever their number of files.
    places = sorted({file.parent for file in files})
    place = places[int(rng.integers(len(places)))]
    files = [file for file in files if file.parent == place]
    file = files[int(rng.integers(len(files)))]
    name = file.relative_to(copy.parent)
    if copy.is_dir() and rng.random() < 0.05:
        file.unlink()
        return f"{name}: removed"
    mutate = mutate_text if file.suffix in TEXTS and rng.random() < 0.8 else mutate_bytes
    data, how = mutate(file.read_bytes(), rng)
    file.write_bytes(data)
    return f"{name}: {how}"


def verdict_of(outcome: Outcome, command: str = "") -> tuple[str, str]:
    """Verdict on the process of a command, and the reason in one line."""
    # libpng writes to standard error.
    lines = [line for line in outcome.err.splitlines() if line.strip() and not line.startswith("libpng ")]
    last = lines[-1][:300] if lines else ""
    if outcome.hung:
        return "hang", f"{outcome.seconds:.0f} s"
    if outcome.memory > MEMORY or outcome.code == OUT_OF_MEMORY:
        return "memory", last or f"{outcome.memory >> 20} MB"
    if outcome.code < 0:
        return "killed", signal.Signals(-outcome.code).name
    if outcome.code == TRACEBACK or "Traceback (most recent call last)" in outcome.err:
        return "traceback", last
    if outcome.code == 0:
        return "ok", ""
    if outcome.code == 2:
        return ("refused", last) if lines else ("wrong message", "exit code 2 without a message")
    if outcome.code != 1:
        return "wrong message", f"exit code {outcome.code}"
    # The reason is in the report of `inspect`; `--write-rig` writes to standard error.
    others = [line for line in lines if not line.startswith(("wrote ", "  cured: ", "  missing: "))]
    if not others and "NOT usable for training" in outcome.out:
        return "refused", "NOT usable for training"
    if not others and command == "check":  # reports damage on standard output
        lines = [f"offpiste: {line}" for line in outcome.out.splitlines()]
        wrong = next(filter(None, (_wrong([line]) for line in lines)), "") if lines else "no report"
        why = "; ".join(filter(None, (wrong, *lines[:1])))[:300]
        return "wrong message" if wrong else "refused", why
    return ("refused", last) if not (wrong := _wrong(lines)) else ("wrong message", f"{wrong}: {last}")


def _wrong(lines: list[str]) -> str:
    """Return the fault of an error message; "" for none."""
    messages = [line for line in lines if line.startswith("offpiste: ")]
    if len(messages) != 1 or len(lines) != 1:
        return f"{len(lines)} lines"
    message = messages[0].removeprefix("offpiste: ")
    if len(message) > LONGEST_LINE:
        return f"{len(message)} characters"
    if not message.isprintable():
        return "unprintable characters"
    if not re.search(r"\w.*[:;] .*\w", message):
        return "neither where nor how"
    return ""
