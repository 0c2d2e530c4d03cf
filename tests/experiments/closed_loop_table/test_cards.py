"""Driven costs on the cards of models that ship."""

import shutil
from dataclasses import replace

import pytest

from experiments.closed_loop_table.cards import write_driving
from offpiste.core.errors import RunError
from offpiste.core.shipped import run_folder
from offpiste.evaluation.model_card import load_card
from offpiste.runtime.planner import load_planner


def results(costs, **about):
    """Of each row's driven costs, course after course."""
    about = {"commit": "abc1234", "date": "2026-11-20", **about}
    return [
        {"row": row, "run_seed": 0, "world": "mojave", "seed": seed, "driven_cost": cost, **about}
        for row, values in costs.items()
        for seed, cost in enumerate(values)
    ]


@pytest.fixture
def planners(tmp_path):
    copies = []
    for name in ("parametric", "b"):
        folder = shutil.copytree(run_folder(f"pretrained:proving-ground/{name}"), tmp_path / name)
        copies.append(replace(load_planner(folder), seed=0))
    return copies


def test_each_card_says_the_cost_against_b(planners):
    costs = {"parametric-100ms": [20.0, 200.0, 2000.0], "b-100ms": [10.0, 100.0, 1000.0]}
    before = load_card(planners[1].folder)
    write_driving(planners, results(costs), 40.0)
    driving = load_card(planners[0].folder).driving
    assert (driving.courses, driving.against_b.mean) == (3, pytest.approx(1.0))
    assert (driving.commit, driving.date) == ("abc1234", "2026-11-20")
    assert driving.against_b.ci95 == (pytest.approx(1.0), pytest.approx(1.0))
    assert load_card(planners[1].folder) == before, "b is not compared with itself"


def test_without_b_or_with_too_few_courses_it_is_one_line(planners):
    with pytest.raises(RunError, match="no `b` to compare with; give the `b` that ships"):
        write_driving(planners[:1], results({"parametric-100ms": [20.0] * 4}), 40.0)
    with pytest.raises(RunError, match="too few courses"):
        write_driving(planners, results({"parametric-100ms": [20.0], "b-100ms": [20.0]}), 40.0)
