"""Kernels step the modules that they were written for, and no others."""

import logging
from collections.abc import Callable
from types import SimpleNamespace

import pytest
import torch
from torch import nn

from factories import VEHICLE, coded
from offpiste.core.errors import RunError
from offpiste.dynamics import MODELS, Hybrid
from offpiste.dynamics.feature_encoder import Compressor
from offpiste.dynamics.kernels import autograd, coverage
from offpiste.dynamics.kernels.actuators import supports_actuators
from offpiste.dynamics.kernels.autograd import supports
from offpiste.dynamics.kernels.coverage import uncovered, uncovered_encoder
from offpiste.dynamics.kernels.encoder import supports_encoder
from offpiste.dynamics.lstm import Compensator
from offpiste.exports.formats import refuse_without_kernels

CPU = torch.device("cpu")


def frozen(model: Hybrid) -> Hybrid:
    model.actuators.requires_grad_(False)
    return model


def exchange(layers: nn.Sequential, number: int, layer: nn.Module) -> None:
    layers[number] = layer


class Mine(Compensator):
    """A subclass, which may compute something else, be it only after training."""


class MyHybrid(Hybrid):
    """Another one."""


INPUTS = Hybrid(VEHICLE).compensator.cell.input_size
CHANGES = {
    "other cell": (lambda m: setattr(m.compensator, "cell", nn.LSTMCell(INPUTS, 4)), "LSTM is a LSTMCell"),
    "other activation": (lambda m: exchange(m.compensator.output, 1, nn.ReLU()), "Tanh is a ReLU"),
    "no bias": (lambda m: exchange(m.compensator.output, 0, nn.Linear(INPUTS + 4, 20, bias=False)), "no bias"),
    "more units": (lambda m: setattr(m, "compensator", Compensator(INPUTS, 4, hidden=8)), "8 units"),
    "other residual": (lambda m: exchange(m.actuators.networks["brake"].output, 1, nn.Sigmoid()), "Tanh is a Sigmoid"),
    "subclass": (lambda m: setattr(m, "compensator", Mine(INPUTS, 4)), "Compensator is a Mine"),
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


def test_subclasses_are_neither_covered_nor_exported(tmp_path, caplog):
    coverage.warn_of_eager_steps.cache_clear()
    with caplog.at_level(logging.WARNING):
        assert not supports(frozen(MyHybrid(VEHICLE)), CPU, torch.float32)
    assert "its Hybrid is a MyHybrid" in caplog.text
    with pytest.raises(RunError, match="its Hybrid is a MyHybrid"):
        refuse_without_kernels(SimpleNamespace(dynamics=MyHybrid(VEHICLE), model="mine", folder=tmp_path))


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
