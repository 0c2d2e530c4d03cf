"""Tables that `offpiste drive` prints."""

from io import StringIO

from rich.console import Console

from offpiste.closed_loop.command import modes_table, stages_table


def test_tables_have_their_units():
    took = {"count": 3, "median_ms": 1.5, "p95_ms": 2.5, "total_s": 0.1}
    result = {"stages": {"plan": took}, "modes": [(0.3, "driving", "")]}
    console = Console(width=100, file=StringIO())
    console.print(stages_table(result))
    console.print(modes_table(result))
    text = console.file.getvalue()
    assert all(unit in text for unit in ("median [ms]", "95 % [ms]", "all [s]", "at [s]"))
