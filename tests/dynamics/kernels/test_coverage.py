"""Kernels step the modules that they were written for, and no others."""

import logging
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor, nn

from factories import VEHICLE, coded
from offpiste.core.errors import RunError
from offpiste.core.state import History, ModelState, Terrain
from offpiste.dynamics import MODELS, Hybrid
from offpiste.dynamics.base import Step
from offpiste.dynamics.feature_encoder import Compressor
from offpiste.dynamics.kernels import autograd, coverage
from offpiste.dynamics.kernels.actuators import supports_actuators
from offpiste.dynamics.kernels.autograd import supports
from offpiste.dynamics.kernels.coverage import uncovered, uncovered_encoder
from offpiste.dynamics.kernels.encoder import supports_encoder
from offpiste.dynamics.lstm import Compensator
from offpiste.dynamics.vehicle import Vehicle
from offpiste.exports.formats import refuse_without_kernels

CPU = torch.device("cpu")


class Doubled(Compensator):
    def forward(self, inputs: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        out, state = super().forward(inputs, state)
        return 2 * out, state


class FurtherGain(Hybrid):
    """A subclass with the parts of its parent, whose steps differ only after training."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self.gain = nn.Parameter(torch.ones(()))

    def stepper(self) -> Step:
        step = super().stepper()

        def scaled(model_state: ModelState, control: Tensor, terrain: Terrain) -> ModelState:
            after = step(model_state, control, terrain)
            return replace(after, state=model_state.state + self.gain * (after.state - model_state.state))

        return scaled


class OtherStart(Hybrid):
    """A subclass that the generated `offpiste_start` of an export does not know."""

    def start(self, history: History, state: Tensor, actuators: Tensor) -> ModelState:
        begun = super().start(history, state, actuators)
        return replace(begun, recurrent=begun.recurrent + 0.5)


def frozen(model: Hybrid) -> Hybrid:
    model.actuators.requires_grad_(False)
    return model


def exchange(layers: nn.Sequential, number: int, layer: nn.Module) -> None:
    layers[number] = layer


INPUTS = Hybrid(VEHICLE).compensator.cell.input_size
CHANGES = {
    "other cell": (lambda m: setattr(m.compensator, "cell", nn.LSTMCell(INPUTS, 4)), "LSTM is a LSTMCell"),
    "other activation": (lambda m: exchange(m.compensator.output, 1, nn.ReLU()), "Tanh is a ReLU"),
    "no bias": (lambda m: exchange(m.compensator.output, 0, nn.Linear(INPUTS + 4, 20, bias=False)), "no bias"),
    "more units": (lambda m: setattr(m, "compensator", Compensator(INPUTS, 4, hidden=8)), "8 units"),
    "other residual": (lambda m: exchange(m.actuators.networks["brake"].output, 1, nn.Sigmoid()), "Tanh is a Sigmoid"),
    "subclass": (lambda m: setattr(m, "compensator", Doubled(INPUTS, 4)), "Compensator is a Doubled"),
    "weight norm": (
        lambda m: nn.utils.parametrizations.weight_norm(m.compensator.output[0]), "Linear is a Parametrized",
    ),
    "hook": (lambda m: m.compensator.output.register_forward_hook(lambda *_: None), "hooks"),
    "other method": (lambda m: setattr(m.compensator, "_standardised", torch.sin), "another _standardised"),
    "other stepper": (lambda m: setattr(m, "stepper", lambda: lambda state, *_: state), "another stepper"),
    "other history": (
        lambda m: setattr(m.compensator, "init_cell", nn.LSTM(INPUTS, 20, num_layers=2, batch_first=True)), "layers",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("change", "reason"), CHANGES.values(), ids=CHANGES)
def test_a_changed_module_is_not_covered_and_one_warning_names_the_reason(
    change: Callable[[Hybrid], object], reason: str, caplog
):
    coverage.warn_of_eager_steps.cache_clear()
    model = frozen(coded(VEHICLE, 0))
    change(model)
    assert reason in uncovered(model)
    with caplog.at_level(logging.WARNING):
        assert not supports(model, CPU, torch.float32)
        assert not supports(model, CPU, torch.float32)
    (line,) = [record.message for record in caplog.records if "eagerly" in record.message]
    assert reason in line
    assert "slower" in line


@pytest.mark.parametrize("kind", [FurtherGain, OtherStart])
def test_subclasses_are_not_covered_even_if_they_differ_only_after_training(kind, tmp_path, caplog):
    coverage.warn_of_eager_steps.cache_clear()
    with caplog.at_level(logging.WARNING):
        assert not supports(frozen(kind(VEHICLE)), CPU, torch.float32)
    assert f"its Hybrid is a {kind.__name__}" in caplog.text
    with pytest.raises(RunError, match=f"its Hybrid is a {kind.__name__}"):
        refuse_without_kernels(SimpleNamespace(dynamics=kind(VEHICLE), model="mine", folder=tmp_path))


def test_a_model_that_kernels_differ_from_is_stepped_eagerly(caplog, monkeypatch):
    coverage.warn_of_eager_steps.cache_clear()
    monkeypatch.setattr(autograd, "largest_difference", lambda *_, **__: float("nan"))
    with caplog.at_level(logging.WARNING):
        assert not supports(frozen(coded(VEHICLE, 0)), CPU, torch.float32)
    assert "they compute something else" in caplog.text


def test_modules_exchanged_after_the_first_use_are_noticed_and_comparing_changes_nothing():
    model = frozen(coded(VEHICLE, 0))
    before, state = torch.get_rng_state(), [p.detach().clone() for p in model.parameters()]
    assert supports(model, CPU, torch.float32)
    assert torch.equal(before, torch.get_rng_state())
    assert all(torch.equal(a, b) for a, b in zip(state, model.parameters(), strict=True))
    exchange(model.compensator.output, 1, nn.ReLU())
    assert not supports(model, CPU, torch.float32)


@pytest.mark.parametrize("name", [name for name in MODELS if MODELS[name](VEHICLE, seed=0).kernel_parts() is not None])
def test_shipped_models_are_covered_and_agree(name):
    model = frozen(MODELS[name](VEHICLE, seed=0))
    assert supports(model, CPU, torch.float32)
    assert not uncovered_encoder(model.encoder)


@pytest.mark.parametrize(("inner", "outer", "size"), [(7, 8, 4), (8, 7, 4), (8, 8, 6), (0, 0, 0)])
def test_encoders_with_other_layers_or_widths_are_not_covered(inner, outer, size):
    encoder = Compressor(3)
    assert supports_encoder(encoder, torch.zeros(2, 3))
    layers = (nn.Linear(4, inner), nn.Tanh(), nn.Linear(inner, outer), nn.Tanh(), nn.Linear(outer, size))
    encoder.layers = nn.Sequential(*layers) if size else nn.Sequential(nn.ReLU(), *encoder.layers[1:])
    assert uncovered_encoder(encoder)
    assert not supports_encoder(encoder, torch.zeros(2, 3))


def test_uncovered_actuators_are_stepped_eagerly_with_a_warning(caplog):
    coverage.warn_of_eager_steps.cache_clear()
    model = frozen(coded(VEHICLE, 0))
    exchange(model.actuators.networks["brake"].output, 1, nn.Sigmoid())
    with caplog.at_level(logging.WARNING):
        assert not supports_actuators(model.actuators, CPU, torch.float32)
    assert "Actuators (its Tanh is a Sigmoid): it is stepped eagerly" in caplog.text
