"""Kernels step the modules that they were written for, and no others."""

import logging
from collections.abc import Callable
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


class GatedCell(nn.Module):
    def __init__(self, inputs: int, hidden: int) -> None:
        super().__init__()
        self.gru = nn.GRUCell(inputs, hidden)
        self.input_size, self.weight_ih, self.weight_hh = inputs, self.gru.weight_ih, self.gru.weight_hh

    def forward(self, inputs: Tensor, state: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        return self.gru(inputs, state[0]), state[1]


class Doubled(Compensator):
    def forward(self, inputs: Tensor, hidden: Tensor, cell: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        out, hidden, cell = super().forward(inputs, hidden, cell)
        return 2 * out, hidden, cell


class FurtherGain(Hybrid):
    """A subclass with the parts of its parent, which steps otherwise only once it has trained."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self.gain = nn.Parameter(torch.ones(()))

    def stepper(self) -> Step:
        step = super().stepper()

        def scaled(model_state: ModelState, control: Tensor, terrain: Terrain) -> ModelState:
            after = step(model_state, control, terrain)
            moved = model_state.state + self.gain * (after.state - model_state.state)
            return ModelState(moved, after.actuators, after.hidden, after.cell)

        return scaled


class OtherStart(Hybrid):
    """A subclass that the generated `offpiste_start` of an export does not know."""

    def start(self, history: History, state: Tensor, actuators: Tensor) -> ModelState:
        begun = super().start(history, state, actuators)
        return ModelState(begun.state, begun.actuators, begun.hidden + 0.5, begun.cell)


def frozen(model: Hybrid) -> Hybrid:
    model.actuators.requires_grad_(False)
    return model


def changed(change: Callable[[Hybrid], object]) -> Hybrid:
    model = frozen(coded(VEHICLE, 0))
    change(model)
    return model


def other_cell(model: Hybrid) -> None:
    cell = model.compensator.cell
    model.compensator.cell = GatedCell(cell.input_size, cell.hidden_size)


def other_activation(model: Hybrid) -> None:
    model.compensator.output[1] = nn.ReLU()


def another_layer(model: Hybrid) -> None:
    model.compensator.output.append(nn.Linear(4, 4))


def no_bias(model: Hybrid) -> None:
    layer = model.compensator.output[0]
    model.compensator.output[0] = nn.Linear(layer.in_features, layer.out_features, bias=False)


def more_units(model: Hybrid) -> None:
    model.compensator = Compensator(model.compensator.cell.input_size, 4, hidden=8)


def other_residual(model: Hybrid) -> None:
    for network in model.actuators.residuals.values():
        network.output[1] = nn.Sigmoid()


def subclassed_network(model: Hybrid) -> None:
    model.compensator = Doubled(model.compensator.cell.input_size, 4)


def weight_norm(model: Hybrid) -> None:
    nn.utils.parametrizations.weight_norm(model.compensator.output[0])


def hook(model: Hybrid) -> None:
    model.compensator.output.register_forward_hook(lambda *_: None)


def backward_hook(model: Hybrid) -> None:
    model.compensator.output[1].register_full_backward_hook(lambda *_: None)


def other_method(model: Hybrid) -> None:
    model.compensator._standardised = lambda inputs: 2 * inputs


def other_stepper(model: Hybrid) -> None:
    model.stepper = lambda: lambda model_state, *_: model_state


def other_history(model: Hybrid) -> None:
    model.compensator.init_cell = nn.LSTM(model.compensator.cell.input_size, 20, num_layers=2, batch_first=True)


CHANGES = {
    other_cell: "LSTMCell is a GatedCell",
    other_activation: "Tanh is a ReLU",
    another_layer: "4 layers in place of 3",
    no_bias: "no bias",
    more_units: "8 units",
    other_residual: "Tanh is a Sigmoid",
    subclassed_network: "Compensator is a Doubled",
    weight_norm: "Linear is a Parametrized",
    hook: "hooks",
    backward_hook: "hooks",
    other_method: "another _standardised",
    other_stepper: "another stepper",
    other_history: "layers",
}


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
def test_a_changed_module_is_not_covered_and_the_reason_is_said(change, caplog):
    coverage.warn_of_eager_steps.cache_clear()
    model = changed(change)
    assert CHANGES[change] in uncovered(model)
    with caplog.at_level(logging.WARNING):
        assert not supports(model, CPU, torch.float32)
        assert not supports(model, CPU, torch.float32)
    (line,) = [record.message for record in caplog.records if "eagerly" in record.message]
    assert CHANGES[change] in line
    assert "slower" in line


def test_a_subclass_is_not_covered_even_if_it_steps_otherwise_only_after_training(caplog):
    coverage.warn_of_eager_steps.cache_clear()
    model = frozen(FurtherGain(VEHICLE))
    with caplog.at_level(logging.WARNING):
        assert not supports(model, CPU, torch.float32)
    assert "its Hybrid is a FurtherGain" in caplog.text


@pytest.mark.parametrize("kind", [FurtherGain, OtherStart])
def test_exports_refuse_subclasses(kind, tmp_path):
    with pytest.raises(RunError, match=f"its Hybrid is a {kind.__name__}"):
        refuse_without_kernels(SimpleNamespace(dynamics=kind(VEHICLE), model="mine", folder=tmp_path))


def test_a_model_that_kernels_differ_from_is_stepped_eagerly(caplog, monkeypatch):
    coverage.warn_of_eager_steps.cache_clear()
    monkeypatch.setattr(autograd, "largest_difference", lambda *_, **__: float("nan"))
    with caplog.at_level(logging.WARNING):
        assert not supports(frozen(coded(VEHICLE, 0)), CPU, torch.float32)
    assert "they compute something else" in caplog.text


def test_modules_exchanged_after_the_first_use_are_noticed():
    model = frozen(coded(VEHICLE, 0))
    assert supports(model, CPU, torch.float32)
    other_activation(model)
    assert not supports(model, CPU, torch.float32)


@pytest.mark.parametrize("name", [name for name in MODELS if MODELS[name](VEHICLE, seed=0).kernel_parts() is not None])
def test_models_that_ship_are_covered_and_agree(name):
    model = frozen(MODELS[name](VEHICLE, seed=0))
    assert supports(model, CPU, torch.float32)
    assert not uncovered_encoder(model.encoder)


def test_a_comparison_leaves_the_model_and_the_global_generator_alone():
    model = frozen(coded(VEHICLE, 0))
    before, state = torch.get_rng_state(), [p.detach().clone() for p in model.parameters()]
    assert supports(model, CPU, torch.float32)
    assert torch.equal(before, torch.get_rng_state())
    assert all(torch.equal(a, b) for a, b in zip(state, model.parameters(), strict=True))


def test_encoders_with_other_layers_are_not_covered():
    encoder = Compressor(3)
    assert supports_encoder(encoder, torch.zeros(2, 3))
    encoder.layers[1] = nn.ReLU()
    assert "Tanh is a ReLU" in uncovered_encoder(encoder)
    assert not supports_encoder(encoder, torch.zeros(2, 3))


@pytest.mark.parametrize(("inner", "outer", "size"), [(7, 8, 4), (8, 7, 4), (8, 8, 6)])
def test_encoders_of_widths_that_the_kernels_misread_are_not_covered(inner, outer, size):
    encoder = Compressor(3)
    layers = (nn.Linear(4, inner), nn.Tanh(), nn.Linear(inner, outer), nn.Tanh(), nn.Linear(outer, size))
    encoder.layers = nn.Sequential(*layers)
    assert uncovered_encoder(encoder)
    assert not supports_encoder(encoder, torch.zeros(2, 3))


def test_actuators_that_are_not_covered_are_stepped_eagerly_with_a_warning(caplog):
    coverage.warn_of_eager_steps.cache_clear()
    model = changed(other_residual)
    with caplog.at_level(logging.WARNING):
        assert not supports_actuators(model.actuators, CPU, torch.float32)
    assert "Actuators (its Tanh is a Sigmoid): it is stepped eagerly" in caplog.text
