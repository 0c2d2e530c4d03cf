"""Tables of car data loggers, with standard names, units and conventions."""

from pathlib import Path

import numpy as np
import pytest

from offpiste.core.errors import LogError
from offpiste.inspection.naming import guess_channels
from offpiste.logs import open_log
from offpiste.rig.channels import Clock

RACELOGIC = """File created on 15/04/2023 at 10:12:13

[header]
satellites
time
latitude

[channel units]
{units}

[comments]
(c) Racelogic

[column names]
sats time lat long velocity heading height vert-vel Steering Throttle

[data]
{rows}"""
ROWS = "\n".join(
    f"011 1012{i // 20:02d}.{5 * (i % 20):02d} +03124.200{i:02d} +00060.899{i:02d} 010.000 050.20 +00120.01 +00.000 "
    f"+{i}.0E+00 +5.0E+01"
    for i in range(60)
)


def test_text_of_windows_is_read_and_said_to_be(tmp_path: Path) -> None:
    """An accent far behind the first lines is found as well."""
    path = tmp_path / "a.csv"
    rows = "".join(f"{0.02 * k:.2f},{k},ok\n" for k in range(500))
    path.write_bytes(f"t,Lenkwinkel [°],état\n{rows}".encode("cp1252"))
    log = open_log(path)
    assert log.topics[""].units == {"Lenkwinkel [°]": "deg"}
    assert log.warnings == ("the text is not UTF-8, and read as cp1252; where names look wrong, save it as UTF-8",)
    path.write_bytes(f"t,x\n{rows.replace(',ok', '')}9.99,3é\n".encode("cp1252"))
    log = open_log(path)
    assert "cp1252" in log.warnings[0]
    with pytest.raises(LogError, match="row 501 below the header, column 'x': '3é' is not a number"):
        log.read("", ["x"])


RACECHRONO = """This file is created using RaceChrono v9.0.2 ( http://racechrono.com/ ).

Format,3
Session title,"A, b"
Created,22/04/2023,10:00
Note,

timestamp,fragment_id,bearing,speed,accelerator_pos,speed
unix time,,deg,m/s,%,km/h
,,100: gps,100: gps,103: obd,103: obd
1650000000.00,0,90.5,10.0,20,36.1
1650000000.05,0,91.5,10.5,21,38.2
1650000000.10,0,92.5,11.0,22,40.3
"""


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_a_file_of_racechrono_has_its_units_and_tells_two_columns_of_one_name_apart(
    tmp_path: Path, newline: str
) -> None:
    path = tmp_path / "session.csv"
    path.write_bytes(RACECHRONO.replace("\n", newline).encode())
    log = open_log(path)
    topic = log.topics[""]
    assert topic.fields == ("timestamp", "fragment_id", "bearing", "speed", "accelerator_pos", "speed (103: obd)")
    assert topic.units == {"bearing": "deg", "speed": "m/s", "accelerator_pos": "percent",
                           "speed (103: obd)": "km/h"}  # fmt: skip
    samples = log.read("", ["speed", "speed (103: obd)"])
    np.testing.assert_array_equal(samples.values, [[10.0, 36.1], [10.5, 38.2], [11.0, 40.3]])
    np.testing.assert_allclose(np.diff(samples.time), 0.05, atol=1e-6)
    guesses = [guess.fields for guess in guess_channels(log) if guess.channel == "wheel_speed"]
    assert guesses[0] == ("speed (103: obd)",)  # not that of the receiver


@pytest.mark.parametrize("units", ["deg\n%", "°\n%", "(null)\n" * 4 + "km/h\n(null)\nm\n(null)\ndeg\n%"])
@pytest.mark.parametrize(
    ("ending", "newline", "encoding"), [(".vbo", "\r\n", "latin-1"), (".txt", "\n", "latin-1"), (".vbo", "\n", "utf-8")]
)
def test_a_file_of_racelogic_has_degrees_to_the_east(
    tmp_path: Path, units: str, ending: str, newline: str, encoding: str
) -> None:
    """Minutes of longitude count to the west; units are listed for all columns or for the last ones."""
    path = tmp_path / f"VBOX0001{ending}"
    path.write_bytes(RACELOGIC.format(units=units, rows=ROWS).replace("\n", newline).encode(encoding))
    log, angle = open_log(path), f"Steering ({'°' if '°' in units else 'deg'})"
    topic = log.topics[""]
    assert {"latitude (deg)", "longitude (deg)", "velocity (km/h)", angle, "Throttle (%)"} <= set(topic.fields)
    assert topic.units[angle] == "deg"
    samples = log.read("", ["latitude (deg)", "longitude (deg)", angle])
    np.testing.assert_allclose(samples.values[0], [3124.2 / 60, -60.899 / 60, 0.0])
    np.testing.assert_allclose(np.diff(samples.time), 0.05, atol=1e-6)
    assert samples.values[-1, 2] == 59.0


def test_columns_of_racecapture_have_their_whole_header_as_name(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    rows = "".join(f"{20 * row},{1425000000000 + 20 * row},10.5\n" for row in range(20))
    path.write_text('"Interval"|"ms"|0|0|1,"Utc"|"ms"|0|0|1,"Speed"|"mph"|0|150|10\n' + rows)
    log = open_log(path, clock=Clock(column='Utc|"ms"|0|0|1', unit="ms"))
    samples = log.read("", ['Speed|"mph"|0|150|10'])
    assert (samples.values[0, 0], len(samples.values)) == (10.5, 20)
    np.testing.assert_allclose(samples.time[:2], [1425000000.0, 1425000000.02], atol=1e-6)
