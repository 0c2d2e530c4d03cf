"""A log whose topics are decoded once: its stamps are those of the log itself, its joints where this log has them."""

import dataclasses

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig

from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.recorded_log import RememberedLog
from offpiste.logs import open_log
from offpiste.logs.log import Topic
from offpiste.rig.channels import Clock


@pytest.mark.parametrize(("label", "clock", "seconds"), [
    ("time [ms]", Clock(), 0.02),
    ("time [ms]", Clock(column="time [ms]", unit="s"), 20.0),
    ("time", Clock(unit="ms"), 0.02),
    ("time", Clock(), 0.02),
])  # fmt: skip
def test_the_unit_of_stamps_is_the_rigs_or_else_the_headers_as_on_opening(tmp_path, label, clock, seconds):
    many = [f"c{number}" for number in range(70)]  # of which not all are kept
    lines = [",".join([label, *many]), *(",".join([str(20 * row), *(["0"] * 70)]) for row in range(5))]
    file = tmp_path / "drive.csv"
    file.write_text("\n".join(lines) + "\n")
    remembered = RememberedLog(open_log(file)).by(clock)
    for fields in (["c1"], ["c69"]):
        wanted = open_log(file, clock=clock).read("", fields).time
        np.testing.assert_allclose(remembered.read("", fields).time, wanted)
        assert np.diff(wanted)[0] == pytest.approx(seconds)


class Joints(MemoryLog):
    """A log whose steering is a topic of joints, named as its columns are."""

    @property
    def topics(self) -> dict[str, Topic]:
        steering = super().topics["steering"]
        named = {f"position[{place}]": joint for place, joint in enumerate(steering.fields)}
        return {**super().topics, "steering": dataclasses.replace(steering, fields=tuple(named), joints=named)}

    def _read(self, topic, fields, stamps):
        joints = self.topics[topic.name].joints
        return super()._read(topic, [joints.get(field, field) for field in fields], stamps)


@pytest.mark.parametrize("order", [("command", "angle", "wheel"), ("wheel", "command", "angle"), ("angle", "command")])
def test_joints_are_checked_where_a_log_has_them(order: tuple[str, ...]) -> None:
    clean = drive_log()
    time, columns = clean.data["steering"]
    columns = columns | {"wheel": 0.3 * np.arange(len(time))}
    log = Joints({**clean.data, "steering": (time, {name: columns[name] for name in order})})
    changes = [
        (f'fields = ["{joint}"]', f'fields = ["position[{place}]"]\njoints = ["{joint}"]')
        for place, joint in enumerate(("command", "angle"))
    ]
    assert not inspect_log(log, rig(*changes)).findings
