"""What the demo may say of its own small numbers, worked by hand."""

import numpy as np
import pytest

from offpiste.dataset.store import Dataset
from offpiste.demo import MAP, compared, conclusion, gain_of
from offpiste.evaluation.errors import Errors
from offpiste.evaluation.intervals import PairedDifference
from seen_drives import seen_dataset


def errors(distance: np.ndarray) -> Errors:
    """Windows 0.5 s apart on one drive, off by these distances after 5 s."""
    values = np.zeros((len(distance), 5, 5))
    values[:, -1, 0] = distance
    return Errors(np.zeros(len(distance), int), 25 * np.arange(len(distance)), values, np.ones(len(distance)))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """36 s to train, 18 s to test."""
    return seen_dataset(tmp_path_factory.mktemp("demo") / "seen.zarr")


def test_the_gain_is_relative_to_b_on_the_same_windows() -> None:
    halves = np.tile([2.0, 6.0], 60)  # mean 4
    read = {
        "hindsight": {"b": errors(halves), "dc": errors(0.75 * halves)},
        MAP: {"b": errors(halves), "dc": errors(halves)},
    }
    assert gain_of(read["hindsight"]).mean == pytest.approx(-0.25)
    assert gain_of(read["hindsight"]).ci95 == pytest.approx((-0.25, -0.25))
    table = compared(read)
    assert table.names == ("ground", "b", "dc", "dc against b")
    assert [line[0] for line in table.lines] == ["hindsight", MAP]
    assert table.lines[0][1].startswith("4.00 [")
    assert table.lines[0][3] == "-25.0 % [-25.0, -25.0]"
    assert table.lines[1][3] == "+0.0 % [0.0, 0.0]"
    assert "120 windows" in table.title


@pytest.mark.parametrize(
    ("gain", "said"),
    [
        (
            PairedDifference(-0.2, (-0.3, -0.1)),
            "Here dc is 20 % below b, with 36 s of driving to learn from and 18 s to",
        ),
        (PairedDifference(-0.2, (-0.5, 0.1)), "No difference between dc and b is shown here"),
        (PairedDifference(0.2, (0.1, 0.3)), "Here dc is 20 % above b: 36 s of driving"),
        (PairedDifference(-0.2, (np.nan, np.nan)), "Nothing can be said of dc against b here"),
    ],
)
def test_no_more_is_claimed_than_the_interval_allows(dataset: Dataset, gain: PairedDifference, said: str) -> None:
    assert conclusion(gain, dataset).startswith(said)
