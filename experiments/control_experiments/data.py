"""Datasets and folders of control experiments."""

from collections.abc import Sequence
from pathlib import Path

from experiments.control_experiments.reproduced import Reproduced
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.inspection.extract import extract
from offpiste.rig.rig import Rig, load_rig

RIG = "proving_ground"
ELSEWHERE = "give the same again, or choose another --out"


def oracle_dataset(logs: Sequence[Path], split: str, out: Path, rig: Rig | None = None) -> Dataset:
    """The true properties of the ground under the wheels of the same drives (`logs.ground_truth.GROUND_PROPERTIES`)."""
    return extract(logs, rig or load_rig(RIG), out, split=split, features="ground-truth", force=True)


def true_ground(of: Reproduced, folder: Path) -> Dataset:
    """The same of a reproduction's drives.

    Args:
        folder: where they are extracted to if the reproduction does not keep them.
    """
    if of.kept_truth.exists():
        truth = open_dataset(of.kept_truth)
    else:
        truth = oracle_dataset(of.logs(), of.split_for(folder), folder / "dataset.zarr", of.dataset.rig)
    return truth.starting_above(of.size.train.min_speed)
