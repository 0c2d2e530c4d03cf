"""Assumptions behind a dataset: inputs that were not measured, or that a vehicle would not have while it drives."""

from collections.abc import Sequence

from offpiste.dataset.store import Dataset
from offpiste.logs.clock_drift import ALIGNED
from offpiste.rig.labels import is_measured_steering


def assumptions_of(dataset: Dataset) -> tuple[str, ...]:
    """Return the assumptions behind a dataset, a sentence each, from its rig, notes and findings."""
    rig, vehicle = dataset.rig, dataset.rig.vehicle
    guessed = f"guessed vehicle: {vehicle.mass:g} kg, wheelbase {vehicle.wheelbase:.3g} m; measure both"
    aligned = [(drive.name, note) for drive in dataset.drives for note in drive.notes if note.startswith(ALIGNED)]
    jumps = [(drive.name, found) for drive in dataset.drives for found in drive.findings if found.what == "jumps"]
    conditions = {
        guessed: vehicle.is_guessed,
        **{f"{name}: {note}, in hindsight": True for name, note in aligned},
        "surface normals: slope of the path driven later": not dataset.features and rig.motion.normals == "driven path",
        "surface normals: flat ground": rig.motion.normals == "flat",
        "future steering: measured angle instead of the command": (
            "steer" in rig.channels and is_measured_steering("steer", rig)
        ),
        "terrain features: the simulator's true ground": bool(dataset.features) and dataset.pca is None,
        **{f"{name}: {found.where} {found.what} ({found.evidence})": True for name, found in jumps},
    }
    return tuple(assumption for assumption, holds in conditions.items() if holds)


def assumptions_block(assumptions: Sequence[str]) -> str:
    """Return assumptions as a short block of text."""
    return "\n".join(["Assumptions:", *(f"  {each}" for each in assumptions or ("none known",))])
