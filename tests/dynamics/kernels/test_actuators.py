"""The actuators' kernels against the eager delay models in float64: values, and every gradient that fits them."""

import copy

import pytest
import torch
from torch import Tensor

from dynamics.kernels.test_rollout import (
    CHANNELS,
    Result,
    assert_agree,
    assert_same_for_threads,
    example,
    gradients,
    windows,
)
from offpiste.core.conventions import ACTUATORS
from offpiste.dynamics import Parametric
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.kernels.actuators import rollout_actuators, supports_actuators

LEAVES = ("start", "recurrent")


def actuators_of(channels: str) -> Actuators:
    """Delay models with random weights and ranges, in float64."""
    return example(*CHANNELS[channels], codes=0, kind=Parametric).actuators.requires_grad_(True)


def inputs(model: Actuators, batch: int, steps: int) -> dict[str, Tensor]:
    """Random input in every branch: brakes applying, releasing and at rest, driving forwards, backwards, standing."""
    model_state, controls, _ = windows(Parametric(model.vehicle, model), batch, steps)
    speed = 4 * torch.randn(batch, steps, generator=torch.Generator().manual_seed(batch))
    speed[::5] = 0
    started = {"start": model_state.actuators, "recurrent": model_state.recurrent}
    return started | {"controls": controls, "speed": speed}


def run(model: Actuators, given: dict[str, Tensor], *, eager: bool) -> Result:
    """The actuators, and the gradients of the recorded ones."""
    dtype = model.raw.dtype
    given = {name: value.to(dtype, copy=True).requires_grad_(name in LEAVES) for name, value in given.items()}
    assert supports_actuators(model, model.raw.device, dtype) is not eager
    found = model.rollout(**given) if eager else rollout_actuators(model, **given)
    present = [i for i, name in enumerate(ACTUATORS) if name in model.vehicle.actuators]
    return (found,), gradients(model, {name: given[name] for name in LEAVES}, found[..., present])


@pytest.mark.parametrize(
    ("channels", "batch", "steps"),
    [
        ("all", 1, 3), ("all", 70, 5), ("all", 20, 100), ("only engine", 33, 8), ("brake and steer", 33, 8),
        ("no throttle", 33, 8), ("no brake", 33, 8), ("steer without command", 33, 8), ("gear", 33, 8),
    ],
)  # fmt: skip
def test_kernels_agree_with_the_eager_models(channels: str, batch: int, steps: int) -> None:
    model = actuators_of(channels)
    given = inputs(model, batch, steps)
    found = run(copy.deepcopy(model).float(), given, eager=False)
    assert_agree(found, run(model, given, eager=True))


def test_numbers_do_not_depend_on_gradients_and_threads() -> None:
    model = actuators_of("all").float()
    given = inputs(model, 100, 7)
    assert_same_for_threads(lambda: run(model, given, eager=False))


def test_a_frozen_residual_has_no_gradient_and_other_types_are_refused() -> None:
    model = actuators_of("all").float()
    model.networks["brake"].requires_grad_(False)
    given = inputs(model, 5, 4)
    _, found = run(model, given, eager=False)
    assert "raw" in found
    assert not any(name.startswith("residuals.brake") for name in found)
    with pytest.raises(ValueError, match="no kernels"):
        rollout_actuators(model, **{name: value.double() for name, value in given.items()})
