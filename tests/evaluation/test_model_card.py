"""Cards of models: written, read, damaged, and as a page."""

import msgspec
import pytest

from offpiste.core.errors import RunError
from offpiste.evaluation.intervals import Levels, PairedDifference
from offpiste.evaluation.model_card import (
    CARD,
    PAGE,
    CourseFigures,
    GroupFigures,
    ModelCard,
    card_page,
    load_card,
    write_card,
)

ALL = GroupFigures(
    "all", 640, Levels(12, 60), PairedDifference(3.04, (2.5, 3.5)), PairedDifference(-0.24, (-0.3, -0.2))
)
CARD_OF_ONE = ModelCard(
    name="here/dc",
    about="A model.",
    trained_on="some driving",
    evaluated_on="other driving",
    lookup="the map",
    seed=2,
    seeds=(0, 1, 2),
    commit="abc",
    date="2026-11-22",
    figures=(ALL, msgspec.structs.replace(ALL, group="on gravel", windows=40, against_b=None)),
    over_seeds=msgspec.structs.replace(ALL, levels=Levels(12, 60, 3)),
    not_for=("A real vehicle.",),
)


@pytest.mark.parametrize(("high", "shown"), [(0.34, False), (-0.1, True)])
def test_a_card_is_read_as_it_was_written_and_its_page_says_all(tmp_path, high, shown):
    driving = CourseFigures(20, PairedDifference(-0.2, (-0.54, high)), "abc", "2026-11-23")
    card = msgspec.structs.replace(CARD_OF_ONE, driving=driving)
    write_card(tmp_path, card)
    assert load_card(tmp_path) == card
    page = (tmp_path / PAGE).read_text("utf-8")
    assert page.startswith("# here/dc\n")
    for text in ("seed 2, of the least validation loss among seeds 0, 1, 2", "A real vehicle.", "Apache-2.0"):
        assert text in page
    rows = [line for line in page.splitlines() if line.startswith("| ")]
    (gravel,) = (row for row in rows if "on gravel" in row)
    assert "| 40 |" in gravel
    assert "-24" not in gravel
    assert sum("-24 % [-30, -20]" in row for row in rows) == 2
    assert f"its driving cost differs from that of `b` by -20 % [-54, {100 * high:.0f}]" in page
    assert ("no difference is shown" in page) != shown
    assert "drives with it" not in card_page(CARD_OF_ONE)


@pytest.mark.parametrize("content", [None, b"{}", b"\xff"])
def test_no_card_is_one_line(tmp_path, content):
    if content is not None:
        (tmp_path / CARD).write_bytes(content)
    with pytest.raises(RunError, match="is not a model card"):
        load_card(tmp_path)
