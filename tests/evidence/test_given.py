"""What a user gives: refused before a folder is begun, and known again by its content."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from offpiste.core.errors import LogError, OffpisteError, RigError, RunError
from offpiste.evidence.collect import EvidenceSettings, collect, compared_features
from offpiste.evidence.given import Drives, described, given_drives, inspect_drives
from offpiste.reproduction.settings import Size, defaults
from offpiste.reproduction.steps import claim_folder
from offpiste.rig.rig import load_rig
from offpiste.training.checkpoint import load_json, save_json
from sensor_bags import sensor_rig
from sensor_drive import RIG, good_drive

SIZE = Size("tiny", (30.0, 15.0, 15.0))


def claim(out: Path, folder: Path, log: str = "good.mcap", split: str = "blocks:0.7,0.1,0.2") -> None:
    rig = str(folder / "rig.toml")
    drives = given_drives((str(folder / log),), rig, split)
    claim_folder(out, described(SIZE, drives, rig), defaults=defaults())


def test_the_same_content_is_known_wherever_it_lies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good_drive(tmp_path)
    out = tmp_path / "out"
    claim(out, tmp_path)
    shutil.copytree(tmp_path, tmp_path / "copied", ignore=shutil.ignore_patterns("copied"))
    claim(tmp_path / "copied/out", tmp_path / "copied")
    monkeypatch.chdir(tmp_path)
    rig = "rig.toml"
    claim_folder(Path("out"), described(SIZE, given_drives(("good.mcap",), rig, "blocks:0.7,0.1,0.2"), rig))
    (tmp_path / rig).write_text(f"# A comment.\n{RIG}")
    claim(out, tmp_path)


def test_another_rig_log_or_split_is_named(tmp_path: Path) -> None:
    good_drive(tmp_path)
    out = tmp_path / "out"
    claim(out, tmp_path)
    mass = re.search(r"^mass = .*$", RIG, re.MULTILINE)
    assert mass is not None
    (tmp_path / "rig.toml").write_text(RIG.replace(mass[0], "mass = 1234.0"))
    with pytest.raises(RunError, match=r"other settings \(rig\.vehicle\.mass\)"):
        claim(out, tmp_path)
    (tmp_path / "rig.toml").write_text(RIG)
    with pytest.raises(RunError, match=r"other settings \(split\)"):
        claim(out, tmp_path, split="blocks:0.6,0.2,0.2")
    with (tmp_path / "good.mcap").open("ab") as file:
        file.write(b"more")
    with pytest.raises(RunError, match=r"other settings \(logs\.good\)"):
        claim(out, tmp_path)


def test_a_setting_that_came_later_has_its_default(tmp_path: Path) -> None:
    good_drive(tmp_path)
    out = tmp_path / "out"
    claim(out, tmp_path)
    kept = load_json(out / "settings.json")
    del kept["size"]["sensors"], kept["size"]["train"]["relative"]
    save_json(out / "settings.json", kept)
    claim(out, tmp_path)
    kept["size"]["train"]["epochs"] = 99
    save_json(out / "settings.json", kept)
    with pytest.raises(RunError, match=r"other settings \(size\.train\.epochs\)"):
        claim(out, tmp_path)


def test_bad_logs_are_refused_before_anything_is_made(tmp_path: Path) -> None:
    good_drive(tmp_path)
    rig, out = str(tmp_path / "rig.toml"), tmp_path / "out"
    with pytest.raises(LogError, match=r"godo\.mcap: no such file"):
        collect(EvidenceSettings(out, SIZE, logs=(str(tmp_path / "godo.mcap"),), rig=rig))
    twice = (str(tmp_path / "good.mcap"), str(tmp_path / "again/good.mcap"))
    (tmp_path / "again").mkdir()
    shutil.copy(twice[0], twice[1])
    with pytest.raises(OffpisteError, match="two logs are called 'good'"):
        collect(EvidenceSettings(out, SIZE, logs=twice, rig=rig))
    with pytest.raises(OffpisteError, match="leave --weights out"):
        collect(EvidenceSettings(out, SIZE, logs=twice[:1], rig=rig, weights="filterbank"))
    assert not out.exists()


def test_logs_are_inspected_with_their_sensors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good_drive(tmp_path)
    rig = load_rig(tmp_path / "rig.toml")
    drives = Drives((str(tmp_path / "good.mcap"),), rig, "blocks:0.7,0.1,0.2")
    with pytest.raises(RigError, match="it has no sensors; add"):
        inspect_drives(replace(drives, rig=sensor_rig("")), rig="my.toml")
    with pytest.raises(LogError, match=r"there is no control channel.*`offpiste inspect .* --rig my.toml` says more"):
        inspect_drives(drives, rig="my.toml")
    monkeypatch.setattr("offpiste.evidence.given.findings_on", lambda log, rig: ())
    inspect_drives(drives, rig="my.toml")
    (tmp_path / "other.toml").write_text(RIG.replace('"/points"', '"/nowhere"'))
    with pytest.raises(OffpisteError, match="/nowhere"):
        inspect_drives(replace(drives, rig=load_rig(tmp_path / "other.toml")), rig="other.toml")


def test_other_weights_in_the_same_folder_have_features_of_their_own(tmp_path: Path) -> None:
    transformers = pytest.importorskip("transformers")
    tiny = {"hidden_size": 32, "num_attention_heads": 2, "num_hidden_layers": 1, "image_size": 70, "patch_size": 14}
    folders = set()
    for _ in range(2):
        transformers.Dinov2Model(transformers.Dinov2Config(**tiny)).save_pretrained(tmp_path / "private" / "vit")
        _, vit = compared_features(str(tmp_path / "private" / "vit"), "cpu")
        assert vit.name == "vit", "no path of the user's machine"
        folders.add(vit.folder)
    assert len(folders) == 2
    shutil.move(tmp_path / "private", tmp_path / "elsewhere")
    assert compared_features(str(tmp_path / "elsewhere" / "vit"), "cpu")[1].folder in folders
