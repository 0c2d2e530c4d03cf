"""Tables for the terminal, for logs and in Markdown."""

from io import StringIO

from rich.console import Console

from offpiste.report.text_table import Cell, TextTable


def test_units_in_brackets_are_no_styles() -> None:
    console = Console(width=80, file=StringIO())
    console.print(TextTable("Errors [m]", ("model", "median [m]"), (("b", "1.0 [m]"),)).rich())
    text = console.file.getvalue()
    assert all(one in text for one in ("Errors [m]", "median [m]", "1.0 [m]"))


def test_a_table_as_plain_text_and_in_markdown() -> None:
    names = ("model", "1 s [m]", "5 s [m]")
    table = TextTable("Errors [m]", names, (("b", Cell("1.0", "[0.5, 1.5]"), "2"),), "Means.", groups=("causal",))
    text = table.text()
    assert all(one in text for one in ("Errors [m]", "causal: 5 s [m]", "1.0 [0.5, 1.5]"))
    assert "\x1b" not in text
    assert table.markdown() == (
        "## Errors [m]\nMeans.\n\n| model | 1 s [m] | 5 s [m] |\n| --- | --- | --- |\n| b | 1.0 [0.5, 1.5] | 2 |\n"
    )
