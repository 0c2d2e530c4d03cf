"""The compiled library: the same numbers from every instruction set, and what happens without it."""

import copy
import logging
import platform
import shutil

import numpy as np
import pytest
import torch

from dynamics.kernels.test_rollout import CHANNELS, assert_agree, example, run, windows
from offpiste.core.errors import OffpisteError
from offpiste.core.state import RecordedTerrain
from offpiste.dynamics import Hybrid, rollout
from offpiste.dynamics.kernels import autograd, coverage
from offpiste.dynamics.kernels.autograd import rollout_recorded, supports
from offpiste.native import compiler, library, tensors
from offpiste.planning.controls import CONTROL_LIMITS, keep_within, keep_within_stepwise
from offpiste.planning.costs.text import shipped_terms_text
from offpiste.planning.course import along_path

NARROWER = {"avx512": ("avx2", "baseline"), "avx2": ("baseline",)}
"""Instruction sets that a processor has besides its best one."""


@pytest.fixture
def without_library(monkeypatch):
    for module in (library, autograd, compiler, tensors):
        monkeypatch.setattr(module, "library", lambda: None)
    monkeypatch.setattr("offpiste.planning.controls.library", lambda: None)
    monkeypatch.setattr("offpiste.planning.course.library", lambda: None)
    coverage.warn_of_eager_steps.cache_clear()


@pytest.mark.skipif(not shutil.which("g++"), reason="no compiler")
def test_the_installation_built_every_library():
    built = library.SETS if platform.machine() == "x86_64" else ("baseline",)
    assert [name for name in built if library._loaded(name) is None] == []


def test_every_instruction_set_agrees_with_the_eager_model(monkeypatch):
    model = example(*CHANNELS["all"], codes=3, kind=Hybrid)
    inputs = windows(model, 50, 9)
    wanted = run(model, inputs, None)
    for name in NARROWER.get(library.instruction_set(), ()):
        loaded = library._loaded(name)
        assert loaded is not None
        monkeypatch.setattr(tensors, "library", lambda loaded=loaded: loaded)
        assert_agree(run(copy.deepcopy(model).float(), inputs, rollout_recorded), wanted)


def test_without_it_models_are_stepped_eagerly_and_a_line_says_what_to_install(without_library, caplog):
    model = example(*CHANNELS["all"], codes=0, kind=Hybrid).float()
    model_state, controls, terrain = windows(model, 3, 2)
    with caplog.at_level(logging.WARNING):
        assert not supports(model, torch.device("cpu"), torch.float32)
        assert not supports(model, torch.device("cpu"), torch.float32)
    assert [record.message for record in caplog.records] == [
        f"the kernels do not cover Hybrid ({library.MISSING}): it is stepped eagerly, {coverage.EAGER_COST}"
    ]
    assert rollout(model, model_state, controls, RecordedTerrain(terrain)).state.shape == (3, 2, 6)


def test_without_it_controls_and_courses_are_computed_by_torch_and_scipy(without_library):
    wanted = torch.randn(5, 20, 3, generator=torch.Generator().manual_seed(0))
    found = keep_within(CONTROL_LIMITS, 0.02, wanted, torch.zeros(3))
    assert torch.equal(found, keep_within_stepwise(CONTROL_LIMITS, 0.02, wanted, torch.zeros(3)))
    path = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    cells = along_path(path, np.array([[1], [2], [3]], np.float32), np.array([0.0, 2.0]), np.array([0.0, 3.0]))
    np.testing.assert_allclose(cells, [[[0, 1], [0, 3]], [[3, 1], [3, 3]]])


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [("__file__", "{}/library.py", "file too short"), ("digest", lambda: "x", "built from other")],
)
def test_a_damaged_library_and_one_of_other_sources_are_done_without(name, value, said, tmp_path, monkeypatch, caplog):
    (tmp_path / "_baseline.so").touch()
    monkeypatch.setattr(library, name, value.format(tmp_path) if isinstance(value, str) else value)
    library._loaded.cache_clear()
    assert library._loaded("baseline") is None
    library._loaded.cache_clear()
    assert said in caplog.text
    assert "install offpiste again" in caplog.text


def test_entries_refuse_arrays_of_another_type_or_layout():
    for items, other in (("f4", "f8"), ("f8", "f4")):
        copy = library.entry("sources", items)
        for array in (np.zeros(3, other), np.zeros((4, 2), items)[:, 0]):
            with pytest.raises(TypeError, match=f"contiguous arrays of {np.dtype(items)}"):
                copy(array)


def test_entries_run_as_written_without_the_library(monkeypatch, caplog):
    @library.compiled("f8", float)
    def grow(values, by):
        values += by

    monkeypatch.setattr(library, "library", lambda: None)
    values = np.zeros(2)
    grow(values, 1.5)
    assert values.tolist() == [1.5, 1.5]
    assert library.MISSING in caplog.text
    with pytest.raises(OffpisteError, match="install g"):
        library.entry("grow", "f8", float)(values, 1.5)


def test_what_is_not_contiguous_is_refused():
    with pytest.raises(ValueError, match="not contiguous"):
        tensors.address(torch.zeros(3, 4).t())
    with pytest.raises(ValueError, match="not contiguous"):
        tensors.address(np.zeros((3, 4)).T)


@pytest.mark.parametrize("what", ["no compiler", "code that does not compile", "no place for it"])
def test_added_costs_that_cannot_be_compiled_are_left_to_torch(what, tmp_path, monkeypatch, caplog):
    (tmp_path / "file").touch()
    monkeypatch.setenv("OFFPISTE_CACHE", str(tmp_path / "file" if what == "no place for it" else tmp_path))
    if what == "no compiler":
        monkeypatch.setattr("shutil.which", lambda name: None)
    compiler.planning_library.cache_clear()
    assert compiler.planning_library(shipped_terms_text() + "nonsense") is None
    assert "eagerly" in caplog.text
    assert not list(tmp_path.rglob("*.so"))
