"""Refusals of `offpiste live` before anything starts, each in one line."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from cli.command import refusal
from live.synthetic_robot import ENABLE, RUN, START, cloud, live_settings, odometry, tree, write_course, write_rig
from offpiste.core.errors import LiveError, OffpisteError
from offpiste.core.shipped import run_folder
from offpiste.live.commands import run_live
from offpiste.live.session import RecordSettings, refuse_unmeasured
from offpiste.live.viewers import listening_at
from offpiste.logs.ros.writer import McapWriter
from offpiste.planning.caution import AddSpread
from offpiste.rig.outputs import Timeouts
from offpiste.rig.rig import load_rig
from offpiste.runtime.planner import load_planner
from offpiste.runtime.settings import RuntimeSettings
from offpiste.transport.zenoh_transport import ZenohSettings
from offpiste.uncertainty.fit import FILE as SPREAD


def refused(settings, what, **options):
    with pytest.raises(OffpisteError, match=what):
        run_live(settings, **options)


@pytest.mark.parametrize(
    ("changed", "options", "what"),
    [
        ({"robot": ZenohSettings(keys="bridge"), "drive": True}, {}, r"type of the enable topic /enable.*live.types"),
        (
            {"record": RecordSettings(Path("a.mcap")), "view": "rerun", "clock": "clock"},
            {"replay": Path("a.mcap")},
            "--replay: --record and --view and --clock clock would have no effect",
        ),
        ({}, {"commands": Path("a.csv")}, "--commands would have no effect"),
        ({"seconds": 0.0}, {}, "0 seconds"),
    ],
)
def test_options_without_effect_are_refused(tmp_path, changed, options, what):
    refused(live_settings(tmp_path, ENABLE, **changed), what, **options)


def test_a_risk_without_a_spread_and_a_missing_gpu_are_refused(tmp_path):
    run = tmp_path / "run"
    shutil.copytree(run_folder(RUN), run, ignore=shutil.ignore_patterns(SPREAD))
    risky = live_settings(tmp_path, actuators=True, run=str(run), runtime=RuntimeSettings(risk=AddSpread()))
    refused(risky, "needs a spread")
    if not torch.cuda.is_available():
        refused(replace(risky, runtime=RuntimeSettings(device="cuda")), "no GPU 'cuda' for planning")


def test_the_timeouts_of_the_rig_are_used(tmp_path, monkeypatch):
    begun, more = [], "[live.timeouts]\nstate = 0.25\n"
    monkeypatch.setattr("offpiste.live.commands.supervise", lambda settings: begun.append(settings))
    settings = live_settings(tmp_path, more, actuators=True)
    run_live(settings)
    assert begun[0].runtime.timeouts == Timeouts(state=0.25)


def test_a_model_whose_inputs_the_rig_lacks_is_refused(tmp_path, caplog):
    refused(live_settings(tmp_path, drive=True), r"reads brake, .*engine_rpm, which rig 'synthetic' does not have")
    assert "without a dead man's switch" in caplog.text
    with pytest.raises(LiveError, match=r"reads images, and rig 'synthetic' has no cameras"):
        refuse_unmeasured(load_planner("pretrained:proving-ground/dc"), load_rig(write_rig(tmp_path, actuators=True)))


@pytest.mark.parametrize(
    ("more", "field", "what"),
    [
        ('[live.types]\n"/odom" = "my_msgs/msg/Odom"\n', "acceleration", r"my_msgs/msg/Odom is unknown.*live.defin"),
        (ENABLE + 'field = "on"\n[live.types]\n"/enable" = "std_msgs/msg/Bool"\n', "acceleration", "no field 'on'"),
        ("", "accel", "invalid field"),
    ],
)
def test_unknown_types_and_fields_are_refused(tmp_path, more, field, what):
    settings = live_settings(tmp_path, more, actuators=True, drive=True)
    file = Path(settings.rig)
    file.write_text(file.read_text().replace('"drive.acceleration', f'"drive.{field}'))
    refused(settings, what)


def test_a_replay_writes_its_commands_and_names_a_sensor_that_was_left_out(tmp_path, caplog):
    rear, log, table = '[lidars.rear]\ntopic = "/rear"\noptional = true\n', tmp_path / "a.mcap", tmp_path / "a.csv"
    with McapWriter(log) as writer:
        writer.write("/tf_static", tree(), START)
        for row in range(70):
            stamp = START + row * 20_000_000
            writer.write("/odom", odometry(row / 50), stamp)
            for topic in () if row % 5 else ("/points",) if row < 60 else ("/points", "/rear"):
                writer.write(topic, cloud(row / 50), stamp)
    run_live(live_settings(tmp_path, rear, actuators=True), replay=log, commands=table)
    assert "rear was left out" in caplog.text
    header, *rows = table.read_text().splitlines()
    assert header == "time,throttle,brake,steer,mode,why"
    assert len(rows) > 5


def line(folder, capsys, *options):
    """The one line printed by `offpiste live` with some options."""
    return refusal(capsys, "live", write_rig(folder), "--run", RUN, "--course", write_course(folder), *options)


@pytest.mark.parametrize(
    ("name", "options", "what"),
    [
        ("a.mcap", ("--record-free", "1e6"), "have to stay free; make room on the disk, or lower --record-free"),
        ("a.mcap", ("--record-free", "nan"), "--record-free nan"),
        ("a.mcap", ("--record-size", "0"), "--record-size 0"),
        ("a.mcap", ("--record-seconds", "-5"), "--record-seconds -5"),
        ("", ("--record-free", "3"), "nothing is recorded; give --record, too"),
        ("file.mcap", (), "already exists"),
        ("file.mcap/a.mcap", (), "cannot be written"),
        ("a.csv", (), "ends with .mcap"),
    ],
)
def test_a_recording_that_cannot_be_written_is_refused(tmp_path, capsys, name, options, what):
    (tmp_path / "file.mcap").write_text("x")
    assert what in line(tmp_path, capsys, *options, *["--record", tmp_path / name] * bool(name))
    assert (tmp_path / "file.mcap").read_text() == "x"
    assert not (tmp_path / "a.mcap").exists()


def test_a_viewer_that_cannot_show_anything_is_refused(tmp_path, capsys):
    assert "no viewer 'foxglov'; did you mean 'foxglove'?" in line(tmp_path, capsys, "--view", "foxglov")
    assert "would show nothing; give --view, too" in line(tmp_path, capsys, "--view-at", "drive.rrd")
    (there := tmp_path / "there.rrd").write_bytes(b"")
    assert "already exists" in line(tmp_path, capsys, "--view", "rerun", "--view-at", there)
    with pytest.raises(LiveError, match="not a host and port"):
        listening_at("8765")
