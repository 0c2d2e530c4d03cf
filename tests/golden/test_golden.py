"""Results of the code equal the recorded ones (`golden/record.py`).

The relative and the absolute tolerance are 1e-6, or OFFPISTE_GOLDEN_TOLERANCE, and `ELSEWHERE` on other machines than
the recording one. Integers and texts are equal. Hashes of messages are equal on the recording machine; other hashes are
only counted, and their arrays compared by a selection. `pytest -rP` shows how many hashes were equal.
"""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from golden.record import GROUPS, RECORDED, STRICT, machine, read, recorded_data

FOLDER = Path(__file__).parent / "results"
TOLERANCE = float(os.environ.get("OFFPISTE_GOLDEN_TOLERANCE", "1e-6"))
ELSEWHERE = {"map_layers": 2e-3, "dataset": 5e-2, "training": 2e-3, "closed_loop": 0.3}
"""Tolerance on other machines: a PCA and a training amplify what processors round differently. From an AMD EPYC to
an Intel Xeon (2026-11-24) the worst numbers went 0.0016 of 3, 0.022 of 0.16 (of one cell), and 0.014 of 67 apart. A
closed loop amplifies any rounding: with vectors of another width commands went 0.18 apart after 2 s."""


@pytest.mark.parametrize("group", GROUPS)
def test_golden(group: str) -> None:
    if group in RECORDED and recorded_data() is None:
        pytest.skip("no recorded data; set OFFPISTE_DATA")
    wanted, found = read(FOLDER, group), GROUPS[group]()
    same_machine = json.loads((FOLDER / "machine.json").read_text()) == machine()
    said = [f"{key}: was not recorded" for key in found.keys() - wanted.keys()]
    said += [f"{key}: is not made any more" for key in wanted.keys() - found.keys()]
    hashes = [key for key in wanted if key.endswith(".sha256") and key in found]
    unlike = [key for key in hashes if wanted[key] != found[key]]
    print(f"{group}: {len(hashes) - len(unlike)} of {len(hashes)} hashes equal; the same machine: {same_machine}")
    if group in STRICT and same_machine:
        said += [f"{key}: other bytes" for key in unlike]
    tolerance = TOLERANCE if same_machine else max(TOLERANCE, ELSEWHERE.get(group, 0.0))
    for key in sorted(wanted.keys() & found.keys()):
        if not key.endswith(".sha256") and (difference := different(wanted[key], found[key], tolerance)):
            said.append(f"{key}: {difference}")
    more = "" if len(said) <= 40 else f"\n... and {len(said) - 40} more"
    assert not said, f"{len(said)} of {len(wanted)} differ\n" + "\n".join(said[:40]) + more


def different(wanted: np.ndarray | str, found: np.ndarray | str, tolerance: float) -> str:
    """Describe a difference; empty for equal results."""
    if isinstance(wanted, str) or isinstance(found, str):
        return "" if wanted == found else f"was {shortened(wanted, found)}, is {shortened(found, wanted)}"
    if wanted.shape != found.shape:
        return f"was of shape {wanted.shape}, is {found.shape}"
    if not np.issubdtype(wanted.dtype, np.floating):
        unlike = wanted != found
        return f"{unlike.sum()} of {unlike.size} whole numbers differ" if unlike.any() else ""
    found = found.astype(np.float64)
    unlike = np.isfinite(wanted) != np.isfinite(found)
    if unlike.any():
        return f"{unlike.sum()} of {unlike.size} are finite on one side only"
    known = np.isfinite(wanted)
    if not known.any():
        return ""
    error = np.abs(wanted[known] - found[known])
    allowed = tolerance * (1 + np.abs(wanted[known]))
    if (error <= allowed).all():
        return ""
    at = int((error - allowed).argmax())
    return (
        f"{(error > allowed).sum()} of {error.size} numbers differ, worst: was {wanted[known][at]:.9g}, is "
        f"{found[known][at]:.9g} ({error[at]:.2g}; allowed {allowed[at]:.2g})"
    )


def shortened(text: object, other: object) -> str:
    """Return a text from shortly before its first difference from another one."""
    text, other = str(text), str(other)
    same = next((i for i, (a, b) in enumerate(zip(text, other, strict=False)) if a != b), min(len(text), len(other)))
    return repr(text[max(0, same - 30) : same + 60])
