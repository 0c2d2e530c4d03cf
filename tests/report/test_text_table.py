"""Tables for the terminal, for logs and in Markdown."""

from offpiste.report.text_table import Cell, TextTable


def test_a_table_as_plain_text_and_in_markdown() -> None:
    names = ("model", "1 s [m]", "5 s [m]")
    table = TextTable("Errors [m]", names, (("b", Cell("1.0", "[0.5, 1.5]"), "2"),), "Means.", groups=("causal",))
    text = table.text()
    assert all(one in text for one in ("Errors [m]", "causal: 5 s [m]", "1.0 [0.5, 1.5]")), (
        "units are no styles of rich"
    )
    assert "\x1b" not in text
    assert table.markdown() == (
        "## Errors [m]\nMeans.\n\n| model | 1 s [m] | 5 s [m] |\n| --- | --- | --- |\n| b | 1.0 [0.5, 1.5] | 2 |\n"
    )
