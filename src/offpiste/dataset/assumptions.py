"""Assumptions behind a dataset: inputs that were not measured, or that a vehicle would not have while it drives."""

from collections.abc import Iterator, Sequence

from offpiste.dataset.store import Dataset
from offpiste.logs.clock_drift import ALIGNED
from offpiste.rig.labels import is_measured_steering


def assumptions_of(dataset: Dataset) -> tuple[str, ...]:
    """Return the assumptions behind a dataset, a sentence each, from its rig, notes and findings."""
    return tuple(dict.fromkeys(_assumptions(dataset)))


def assumptions_block(assumptions: Sequence[str]) -> str:
    """Return assumptions as a short block of text."""
    return "\n".join(["Assumptions:", *(f"  {each}" for each in assumptions or ("none known",))])


def _assumptions(dataset: Dataset) -> Iterator[str]:
    rig = dataset.rig
    vehicle = rig.vehicle
    if vehicle.is_guessed:
        yield f"guessed vehicle: {vehicle.mass:g} kg, wheelbase {vehicle.wheelbase:.3g} m; measure both"
    for drive in dataset.drives:
        yield from (f"{drive.name}: {note}, in hindsight" for note in drive.notes if note.startswith(ALIGNED))
    if not dataset.features and rig.motion.normals == "driven path":
        yield "surface normals: slope of the path driven later"
    if rig.motion.normals == "flat":
        yield "surface normals: flat ground"
    if "steer" in rig.channels and is_measured_steering("steer", rig):
        yield "future steering: measured angle instead of the command"
    if dataset.features and dataset.pca is None:
        yield "terrain features: the simulator's true ground"
    for drive in dataset.drives:
        jumps = [finding for finding in drive.findings if finding.what == "jumps"]
        yield from (f"{drive.name}: {finding.where} {finding.what} ({finding.evidence})" for finding in jumps)
