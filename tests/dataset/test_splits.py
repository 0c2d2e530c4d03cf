"""Splits: parts never share a row, keep their distance, and folds cover everything once."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factories import RIG, MemoryLog
from offpiste.core.conventions import HISTORY_STEPS, HORIZON_STEPS
from offpiste.core.errors import DatasetError
from offpiste.dataset.fit_pca import fit_pca
from offpiste.dataset.splits import GAP, PARTS, Split, parse_split, refuse_places_without_origin
from offpiste.dataset.window_starts import window_starts
from offpiste.inspection.extract import extract
from offpiste.logs.channel import read_channel
from offpiste.perception.backbones import open_backbone
from offpiste.rig.rig import Rig, parse_rig


def wandering(rows: int, seed: int = 0) -> np.ndarray:
    """A path that leaves and comes back to places."""
    return np.random.default_rng(seed).normal(0, 0.3, (rows, 2)).cumsum(axis=0) + 0.1 * np.arange(rows)[:, None]


fractions = st.tuples(st.integers(1, 20), st.integers(0, 20), st.integers(0, 20)).map(
    lambda n: "blocks:" + ",".join(f"{x / sum(n):.9f}" for x in n)
)
splits = st.one_of(
    fractions,
    st.sampled_from(["blocks:0.7,0.1,0.2@120", "blocks:0.6,0.2,0.2@60", "blocks:0.5,0,0.5@30.5"]),
    st.integers(3, 7).flatmap(lambda n: st.integers(0, n - 1).map(lambda k: f"fold:{k}/{n}")),
    st.sampled_from(["places:20", "places:50", "places:5"]),
)


@given(splits, st.integers(1, 9000), st.integers(0, 3))
@settings(max_examples=60, deadline=None)
def test_windows_of_different_parts_share_no_row_and_keep_their_distance(text, rows, seed):
    label = parse_split(text).label("drive", wandering(rows, seed))
    assert len(label) == rows
    assert set(np.unique(label)) <= {-1, 0, 1, 2}
    ends = []
    for part in range(3):
        starts = window_starts(label == part)
        assert all(
            (label[t - HISTORY_STEPS : t + HORIZON_STEPS + 1] == part).all()
            for t in starts[:: max(len(starts) // 5, 1)]
        )
        ends += [(t - HISTORY_STEPS, t + HORIZON_STEPS, part) for t in starts]
    ends.sort()
    for (_, last, part), (first, _, other) in pairwise(ends):
        assert part == other or first - last > GAP


def test_blocks_follow_the_fractions_by_time():
    label = parse_split("blocks:0.7,0.1,0.2").label("drive", wandering(20000))
    counts = [(label == part).sum() for part in range(3)]
    assert counts == [14000, 2000 - GAP, 4000 - GAP]
    assert (np.diff(label[label >= 0]) >= 0).all()


def test_blocks_repeat_every_period():
    label = parse_split("blocks:0.7,0.1,0.2@120").label("drive", wandering(20000))
    edges = np.concatenate([start + np.array([0, 4200, 4800]) for start in range(0, 20000, 6000)])
    for first, part in zip(edges, [0, 1, 2] * 4, strict=True):
        if first < len(label):
            assert (label[first : first + GAP] == (part if first == 0 else -1)).all()
            assert (label[first + GAP : first + 500] == part).all()


def test_blocks_too_short_for_windows_are_refused_with_the_least():
    said = r"@60: blocks of 60 s leave 6\.0 s for the smallest part; give @104 or more"
    with pytest.raises(DatasetError, match=said):
        parse_split("blocks:0.7,0.1,0.2@60")
    assert parse_split("blocks:0.7,0.1,0.2@104").period == 104.0


@pytest.mark.parametrize("total", [3, 5, 8])
def test_folds_test_every_row_once_but_for_gaps(total):
    rows = 20000
    labels = np.stack([parse_split(f"fold:{k}/{total}").label("d", wandering(rows)) for k in range(total)])
    tested = (labels == PARTS.index("test")).sum(axis=0)
    assert tested.max() == 1
    assert (tested == 0).sum() <= total * GAP
    for label in labels:
        assert (label == PARTS.index("validation")).sum() > 0
        assert (label == PARTS.index("train")).mean() > 0.3


def test_a_place_has_one_part_in_every_drive_and_on_every_pass():
    split, there = parse_split("places:50"), wandering(6000, 1)
    ours, others = split.label("there", there), split.label("back", there[::-1].copy())[::-1]
    both = (ours >= 0) & (others >= 0)
    assert both.sum() > 500
    assert (ours[both] == others[both]).all()


def geographic_rig(more: str = "") -> Rig:
    text = RIG.replace("[channels.orientation]", f'unit = "lat lon"\n{more}[channels.orientation]', 1)
    return parse_rig(text, where="")


def test_a_place_in_degrees_has_one_part_in_every_drive():
    rig, split = geographic_rig("origin = [48.15, 11.58]\n"), parse_split("places:300")
    refuse_places_without_origin(split, rig)
    count = 20000
    degrees = np.column_stack((np.linspace(48.14, 48.17, count), np.linspace(11.57, 11.6, count)))

    def label(first: int) -> np.ndarray:
        time, zero = 0.02 * np.arange(count - first), np.zeros(count - first)
        place = dict(zip("xyz", (*degrees[first:].T, zero), strict=True))
        channel, _, _ = read_channel(MemoryLog(odometry=(time, place)), rig, "position", rig.channels["position"])
        return split.label("", channel.values[:, :2])

    ours, others = label(0)[9000:], label(9000)
    both = (ours >= 0) & (others >= 0)
    assert both.sum() > 5000
    assert len(set(ours[both])) > 1
    assert (ours[both] == others[both]).all()


def test_places_in_degrees_without_a_common_origin_are_refused_in_one_line(tmp_path):
    message = "places:50: positions in 'lat lon' have an origin of each log.*; give channels.position.origin in the rig"
    with pytest.raises(DatasetError, match=message):
        extract(["one.csv"], geographic_rig(), tmp_path / "d.zarr", split="places:50")
    with pytest.raises(DatasetError, match=message):
        fit_pca(["one.csv"], geographic_rig(), parse_split("places:50"), open_backbone("filterbank"))
    refuse_places_without_origin(parse_split("fold:0/5"), geographic_rig())


@pytest.mark.parametrize(
    "text",
    ["", "blocks", "drives", "blocks:1", "blocks:0.5,0.5,0.5", "blocks:-0.1,0.6,0.5", "blocks:0,0.5,0.5",
     "blocks:a,b,c", "blocks:nan,0.5,0.5", "fold:5/5", "fold:0/2", "fold:1", "places:0", "places:x", "places:inf",
     "random:0.8", "blocks:0.7,0.1,0.2@", "blocks:0.7,0.1,0.2@-3", "blocks:0.7,0.1,0.2@nan", "blocks:0.7,0.1,0.3"],
)  # fmt: skip
def test_what_is_no_split_is_an_error_that_shows_one(text):
    with pytest.raises(DatasetError, match=r"not a split.*blocks:0\.7,0\.1,0\.2"):
        parse_split(text)


def drives_in(folder: Path, content: str) -> Split:
    (folder / "split.txt").write_text(content)
    return parse_split(f"drives:{folder / 'split.txt'}")


def test_drives_go_where_their_file_says(tmp_path):
    split = drives_in(tmp_path, "monday train\n\nfriday test\n")
    assert (split.label("monday", wandering(10)) == 0).all()
    assert (split.label("friday", wandering(10)) == 2).all()
    with pytest.raises(DatasetError, match="names no part for drive 'sunday'"):
        split.label("sunday", wandering(10))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        *((f"sunday train\n{wrong}\n", r"split\.txt: line 2 is not 'NAME PART'")
          for wrong in ("monday", "monday train extra", "monday exam")),
        ("monday train\nmonday train\nmonday test\n",
         "line 3 puts drive 'monday' into test, an earlier one into train"),
    ],
)  # fmt: skip
def test_a_wrong_line_of_a_split_file_is_named(tmp_path, content, said):
    with pytest.raises(DatasetError, match=said):
        drives_in(tmp_path, content)


def test_a_split_file_that_is_missing_is_an_error(tmp_path):
    with pytest.raises(DatasetError, match="cannot read the split"):
        parse_split(f"drives:{tmp_path / 'none.txt'}")
