"""Examples of few units."""

import pytest

MODULES = ("offpiste.evaluation.intervals", "experiments.closed_loop_table.table")


@pytest.fixture(autouse=True)
def three_units_are_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """Examples are small enough to be checked by hand."""
    for module in MODULES:
        monkeypatch.setattr(f"{module}.MIN_UNITS", 3)
