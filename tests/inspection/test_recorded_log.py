"""A log whose topics are decoded once: its stamps are those of the log itself, its joints where this log has them."""

import numpy as np
import pytest

from offpiste.inspection.recorded_log import RememberedLog
from offpiste.logs import open_log
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
