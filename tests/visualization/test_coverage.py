"""Tables for the terminal."""

from io import StringIO

from rich.console import Console

from offpiste.visualization.coverage import TextTable


def test_units_in_brackets_are_no_styles() -> None:
    console = Console(width=80, file=StringIO())
    console.print(TextTable("Errors [m]", ("model", "median [m]"), (("b", "1.0 [m]"),)).rich())
    text = console.file.getvalue()
    assert all(one in text for one in ("Errors [m]", "median [m]", "1.0 [m]"))
