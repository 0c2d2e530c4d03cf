"""What a report stands on, and what speaks against it: vehicle, driving, guesses of the rig, findings, few windows."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from offpiste.core.conventions import HORIZON_STEPS
from offpiste.dataset.split_balance import part_facts, split_warning
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.inspection.draft_values import GUESSED
from offpiste.training.kept_epoch import FEW_WINDOWS

_FOLDERS: Final = re.compile(r"[^:=]*[/\\]")
"""The folders of a path, which may follow a word as `drives:`."""


def vehicle_facts(dataset: Dataset) -> dict[str, str]:
    """The vehicle, its sensors and what it drove, by name."""
    rig, vehicle = dataset.rig, dataset.rig.vehicle
    metres = sum(drive.rows.distance for drive in dataset.drives)
    parts = "; ".join(facts.words for facts in part_facts(dataset))
    return {
        "vehicle": f"{vehicle.mass:.4g} kg, wheelbase {vehicle.wheelbase:.3g} m, track {vehicle.track:.3g} m, "
        f"largest road-wheel angle {vehicle.max_steer:.3g} rad",
        "sensors": f"cameras: {', '.join(rig.cameras) or 'none'}; LiDARs: {', '.join(rig.lidars) or 'none'}",
        "driving": f"{metres / 1000:.2f} km; {parts}",
    }


def doubts(dataset: Dataset, rig: str) -> Iterator[str]:
    """What the console warns of, and what the rig guesses, a line each.

    Args:
        rig: text of the rig's file; "" where the proving ground was driven.
    """
    guesses = list(guessed(rig))
    if guesses:
        yield f"the rig has guesses that nobody has confirmed: {'; '.join(guesses)}"
    yield from (f"inspect: {finding}" for finding in dataset.findings)
    if (line := split_warning(dataset)) is not None:
        yield line.replace(dataset.split.text, _FOLDERS.sub("", dataset.split.text))
    count = len(Windows(dataset, "validation", horizon=HORIZON_STEPS))
    if count < FEW_WINDOWS:
        yield f"the validation part has only {count} windows, by which epochs are chosen: drive more"


def guessed(rig: str) -> Iterator[str]:
    """Entries of a rig's text that still have the mark of a first draft."""
    for line in rig.splitlines():
        before, mark, words = line.partition(GUESSED)
        key = before.split("#")[0].split("=")[0].strip() if mark else ""
        if key == "source":
            yield words.strip(': "')
        elif key:
            yield key


def public_command(words: Sequence[str]) -> str:
    """A command line without the names of logs, and without the folders that paths lie in."""
    kept, logs, option = [Path(words[0]).name], 0, False
    for word in words[1:]:
        if option or word.startswith("--"):
            kept.append(_FOLDERS.sub("", word.rstrip("/\\")))
            option = word.startswith("--") and "=" not in word
        elif word == "evidence":
            kept.append(word)
        else:
            logs += 1
    return " ".join(kept) + (f" ({logs} log{'s' * (logs > 1)})" if logs else "")
