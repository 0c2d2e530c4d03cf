"""Untrained models for a dataset's vehicle."""

from offpiste.core.errors import RunError
from offpiste.dataset.store import Dataset
from offpiste.dynamics import MODELS, Dynamics, Vehicle
from offpiste.training.config import TrainConfig


def vehicle_of(dataset: Dataset, config: TrainConfig | None = None) -> Vehicle:
    """The vehicle of a dataset, as models know it.

    Args:
        config: says how much of the features is read, and how long a code is.
    """
    rig, config = dataset.rig, config or TrainConfig()
    return Vehicle(
        mass=rig.vehicle.mass,
        wheelbase=rig.vehicle.wheelbase,
        max_steer=rig.vehicle.max_steer,
        control=rig.present_controls,
        actuators=rig.present_actuators,
        rear_axle=rig.vehicle.rear_axle,
        features=len(dataset.features),
        pca=config.pca,
        codes=config.codes,
        track=rig.vehicle.track,
    )


def build(model: str, vehicle: Vehicle, *, seed: int) -> Dynamics:
    """An untrained model with initial weights that follow from the seed.

    Raises:
        RunError: no model of that name, or none with so many features or so long a code.
    """
    make = MODELS[model]
    if vehicle.codes < 1:
        raise RunError(f"a code of length {vehicle.codes}", how="give --codes 1 or more")
    if vehicle.features and not 0 <= vehicle.pca <= vehicle.features:
        raise RunError(
            f"reads {vehicle.pca} terrain features; the dataset has {vehicle.features}", how="give a smaller --pca"
        )
    dynamics = make(vehicle, seed=seed)
    if dynamics.encoder is not None and not vehicle.features:
        raise RunError(
            f"model '{model}' reads terrain features and the dataset has none",
            how="extract with --pca (see fit-pca), or train b",
        )
    return dynamics
