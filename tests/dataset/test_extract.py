"""Extraction: warnings before any log is read, and which windows of a drive get a snapshot of the map."""

import logging
from pathlib import Path

import numpy as np
import pytest

from factories import circle_rows, small_rig
from offpiste.core.errors import DatasetError
from offpiste.core.parallel import Outcome
from offpiste.dataset import extract
from offpiste.dataset.extract import Job, _seen_by_pca, _starts, make_dataset
from offpiste.dataset.map_snapshots import SnapshotSettings
from offpiste.dataset.splits import GAP, PARTS, parse_split, write_drives
from offpiste.perception.backbones import open_backbone
from offpiste.perception.feature_extractor import FeatureExtractor
from offpiste.perception.pca import PrincipalComponents

ROWS = 6000


@pytest.mark.parametrize(
    ("split", "warnings"),
    [
        ("blocks:0.7,0.1,0.2", []),
        (
            "blocks:1,0,0",
            ["the split blocks:1,0,0 leaves nothing for validation and test: models cannot be trained or evaluated"],
        ),
        ("blocks:0.8,0.2,0", ["the split blocks:0.8,0.2,0 leaves nothing for test: models cannot be evaluated"]),
    ],
)
def test_a_part_that_stays_empty_is_warned_of(split, warnings, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(extract, "run_all", lambda *arguments, **settings: Outcome([], []))
    with caplog.at_level(logging.INFO, "offpiste"), pytest.raises(DatasetError, match="not a dataset"):
        make_dataset(["one.csv"], small_rig(), tmp_path / "d.zarr", split=split)
    assert [(record.levelname, record.getMessage()) for record in caplog.records] == [("WARNING", w) for w in warnings]


def test_drives_of_a_split_that_are_no_log_are_warned_of(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(extract, "run_all", lambda *arguments, **settings: Outcome([], []))
    (tmp_path / "split.txt").write_text("one train\ntow test\nthree validation\n")
    for logs, warned in ((["one.csv", "two.csv", "three.csv"], ["'tow'"]), (["one.csv", "tow.csv", "three.csv"], [])):
        caplog.clear()
        with caplog.at_level(logging.WARNING, "offpiste"), pytest.raises(DatasetError, match="not a dataset"):
            make_dataset(logs, small_rig(), tmp_path / "d.zarr", split=f"drives:{tmp_path}/split.txt")
        assert [r.getMessage().split(" names ")[1].split(":")[0] for r in caplog.records] == warned


@pytest.mark.parametrize(("then", "now", "seen"), [("train", "test", True), ("test", "test", False)])
def test_a_list_of_drives_that_was_edited_since_the_pca_is_noticed(tmp_path, then, now, seen):
    text = write_drives(tmp_path / "parts.txt", [("drive", now)])
    about = {"logs": ["drive"], "split": text, "split_drives": [["drive", then]]}
    backbone = open_backbone("filterbank")
    channels = backbone.channels
    pca = PrincipalComponents(
        mean=np.zeros(channels, np.float32),
        basis=np.eye(channels, 1, dtype=np.float32),
        variance=np.ones(1, np.float32),
        total_variance=1.0,
        backbone=backbone.name,
        fingerprint=backbone.fingerprint,
        fitted_on=about,
    )
    job = Job(Path("drive.mcap"), "drive", small_rig(), Path("d.zarr"), parse_split(text))
    notes = _seen_by_pca(FeatureExtractor(backbone, pca), circle_rows(ROWS, seed=0, speed=5), job)
    assert [note.startswith("warning: the PCA may have seen 120 s that") for note in notes] == [True] * seen


@pytest.mark.parametrize("parts", [("validation", "test"), ("train", "validation"), ("test",)])
def test_windows_of_the_parts_that_are_asked_for(parts: tuple[str, ...]) -> None:
    split = parse_split("blocks:0.5,0.25,0.25")
    job = Job(Path("drive.mcap"), "drive", small_rig(), Path("d.zarr"), split)
    found = _starts(circle_rows(ROWS, seed=0, speed=5), job, SnapshotSettings(parts=parts))
    # Blocks end at 3000, 4500 and 6000; the first rows of all but the first block are the gap.
    edges = dict(zip(PARTS, ((0, 3000), (3000 + GAP, 4500), (4500 + GAP, ROWS)), strict=True))
    for starts, name in zip(found, parts, strict=True):
        first, last = edges[name]
        assert len(starts) == ROWS
        assert np.flatnonzero(starts)[[0, -1]].tolist() == pytest.approx([first + 10, last - 251], abs=5)
        assert starts.sum() > 100
