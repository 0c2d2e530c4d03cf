"""Examples of few units."""

import pytest


@pytest.fixture(autouse=True)
def three_units_are_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """Examples are small enough to be checked by hand."""
    monkeypatch.setattr("offpiste.evaluation.intervals.MIN_UNITS", 3)
