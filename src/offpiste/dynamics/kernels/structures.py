"""ctypes structures of the compiled library (`native/cpp/model.h`, `recorded.h`), and conversion of models to them."""

from collections.abc import Sequence
from ctypes import Structure, c_int, c_void_p
from typing import Final

import torch
from torch import Tensor

from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.networks import (
    ModelNetwork,
    absent_actuators,
    constants,
    kernel_parts,
    learned_constants,
    model_networks,
)
from offpiste.dynamics.vehicle import Vehicle
from offpiste.native.tensors import Arrays

MOST_NETWORKS: Final = 3
"""Networks of one model: of the forces, the brake and the steering."""


class _Network(Structure):
    _fields_ = (
        *((name, c_int) for name in ("inputs", "width", "outputs", "first_output", "first_unit")),
        *((name, c_void_p) for name in ("rows", "mean", "inverse_scale", "low", "high", "gates", "inner", "outer")),
    )


_Networks = _Network * MOST_NETWORKS  # each new type of an array leaves work to garbage collection


class Model(Structure):
    """A model; it keeps the arrays alive that its addresses point to."""

    _fields_ = (
        *((name, c_void_p) for name in ("constants", "networks", "control_rows", "absent_controls")),
        *((name, c_int) for name in ("network_count", "units", "codes", "columns", "absent", "lags_only")),
    )
    arrays: Arrays


class Record(Structure):
    """Inputs of a rollout over recorded terrain."""

    _fields_ = (
        ("batch", c_int),
        ("steps", c_int),
        *((name, c_void_p) for name in ("start", "controls", "normals", "known", "codes", "speed")),
    )


class Learning(Structure):
    """Adjoints of the three matrices of each network, by chunk."""

    _fields_ = (("matrices", c_void_p * 3 * MOST_NETWORKS),)


def model_of(dynamics: Dynamics, networks: Sequence[ModelNetwork] | None = None) -> Model:
    """Return a model with its weights as they are.

    Args:
        networks: from `model_networks`, to save computing them again.
    """
    _, actuators = kernel_parts(dynamics)
    with torch.no_grad():
        values = constants(learned_constants(dynamics), actuators.flat_constants(), dynamics.vehicle)
    given = model_networks(dynamics) if networks is None else networks
    return _model(dynamics.vehicle, values, given, codes=4 * dynamics.codes)


def lags_of(vehicle: Vehicle, lags: Tensor, networks: Sequence[ModelNetwork]) -> Model:
    """Return a model of the actuators alone, along a recorded speed."""
    values = constants(lags.new_zeros(len(layout.LEARNED)), lags.detach(), vehicle)
    return _model(vehicle, values, networks, lags_only=True)


def _model(
    vehicle: Vehicle, values: Tensor, networks: Sequence[ModelNetwork], *, codes: int = 0, lags_only: bool = False
) -> Model:
    arrays, columns = Arrays(), vehicle.control_columns
    rows = [layout.ROW[layout.CONTROLS[k]] if name in vehicle.control else -1 for k, name in enumerate(columns)]
    given = [_network(arrays, of, layout.HIDDEN * number) for number, of in enumerate(networks)]
    model = Model(
        constants=arrays.floats(values),
        networks=arrays.structures(_Networks(*given)),
        control_rows=arrays.whole(rows),
        absent_controls=arrays.floats(torch.tensor(layout.ABSENT, dtype=torch.float32)),
        network_count=len(networks),
        units=layout.HIDDEN * len(networks),
        codes=codes,
        columns=len(columns),
        absent=sum(1 << k for k in absent_actuators(vehicle)),
        lags_only=lags_only,
    )
    model.arrays = arrays
    return model


def _network(arrays: Arrays, of: ModelNetwork, first_unit: int) -> _Network:
    return _Network(
        inputs=len(of.inputs),
        width=of.width,
        outputs=of.weights.outer.shape[1],
        first_output=of.first_output,
        first_unit=first_unit,
        rows=arrays.whole(list(of.inputs)),
        **{name: arrays.floats(values) for name, values in (of.ranges() | of.weights._asdict()).items()},
    )
