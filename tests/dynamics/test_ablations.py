"""The models that controls compare with."""

from dataclasses import replace

from factories import VEHICLE
from offpiste.dynamics import MODELS


def test_b_wide_has_as_many_parameters_as_dc_and_no_more_than_a_tenth_on_top() -> None:
    paper = replace(VEHICLE, features=80, pca=40, codes=4)
    wide, dc = (sum(p.numel() for p in MODELS[name](paper).parameters()) for name in ("b-wide", "dc"))
    assert dc <= wide <= 1.1 * dc
