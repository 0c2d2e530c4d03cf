"""Pages of reports."""

from pathlib import Path

from offpiste.report.chart import Chart, Panel
from offpiste.report.page import Card, Page, Picture, Section, render, table_section, write_page
from offpiste.report.text_table import Cell, TextTable

TABLE = TextTable(
    "Errors <5 s>",
    ("model", "1 s", "5 s", "1 s", "5 s"),
    [("a < b", Cell("1", "[0, 2]", bold=True), "2", "3", "4")],
    "What <they> are.",
    groups=("causal", "smoothed"),
)
PICTURE = Picture("box", b"\x89PNG", 'a "caption"')
PAGE = Page(
    "<title>",
    ["first", "second & more"],
    {"<fact>": "<value>"},
    [table_section(TABLE, PICTURE), Section("Notes", notes=("a <note>",))],
)


def test_everything_stands_on_a_page_that_needs_no_other_file(tmp_path: Path) -> None:
    assert write_page(PAGE, tmp_path) == [tmp_path / "box.png", tmp_path / "report.html"]
    assert (tmp_path / "box.png").read_bytes() == b"\x89PNG"
    text = (tmp_path / "report.html").read_text("utf-8")
    for escaped in (
        "&lt;title&gt;",
        "second &amp; more",
        "&lt;fact&gt;",
        "&lt;value&gt;",
        "a &lt; b",
        "a &lt;note&gt;",
    ):
        assert escaped in text
    assert 'alt="a &#34;caption&#34;"' in text
    assert '<strong>1 <span class="interval">[0, 2]</span></strong>' in text
    assert "<title>offpiste" in text
    assert text.count('colspan="2"') == 2, "groups span their columns"
    assert "<fact>" not in text
    assert "data:image/png;base64,iVBORw==" in text
    assert not any(word in text for word in ("<script", "<link", "http", "url(", "@import"))


CHARTS = Page(
    "charts",
    ["first"],
    {},
    [Section("a", pictures=[Picture("a", b"\x89PNG", "a", Chart([Panel("</script>")])), PICTURE])],
    [Card("<b>", "1.2 m", "error", "3 % below", "better", "mean", "#0072b2")],
)


def test_a_page_with_charts_holds_cards_and_charts_and_what_draws_them_once() -> None:
    text = render(CHARTS)
    assert text.count('<figure class="charts">') == 1
    assert text.count("data:image/png;base64,") == 2, "a browser without scripts shows all pictures"
    assert text.count('id="plotly"') == 1
    assert text.count("</script>") == text.count("<script") == 3
    assert not any(word in text for word in ("<link", "http:", "https:", 'src="/', "@import"))
    assert text.index("first</p>") < text.index("&lt;b&gt;") < text.index("1.2 m")
    assert '<p class="better">3 % below</p>' in text
    assert "--colour: #0072b2" in text


def test_pages_find_their_way_from_three_sections_on() -> None:
    sections = [Section(name) for name in "abc"]
    assert "<nav>" not in render(Page("t", [], {}, sections[:2]))
    text = render(Page("t", [], {}, sections))
    for number in (1, 2, 3):
        assert f'<a href="#part-{number}">' in text
        assert f'<section id="part-{number}">' in text
