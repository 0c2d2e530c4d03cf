"""A true drive of a bicycle on rolling ground, for tests of known faults: no simulation, known at every moment."""

from functools import cache

import numpy as np

from experiments.inspection_faults.drives import TrueDrive, true_drive
from experiments.inspection_faults.recording import Case, recorded
from offpiste.simulation.vehicle.parameters import load_vehicle
from synthetic_drive import samples

MAX_STEER = load_vehicle().max_steer


@cache
def made_up_drive(seconds: float = 30.0, seed: int = 0) -> TrueDrive:
    return true_drive(samples(seconds, seed), "made up", load_vehicle())


def made_up_case(*needs: str, seed: int = 0) -> Case:
    """A healthy recording of it that has these channels."""
    return recorded(made_up_drive(), np.random.default_rng(seed), needs)
