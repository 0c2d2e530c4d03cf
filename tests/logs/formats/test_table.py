"""CSV and Parquet tables: separators, clocks, cells that are not numbers, damaged files."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from factories import small_rig
from offpiste.core.errors import LogError
from offpiste.logs.channel import read_channel
from offpiste.logs.formats.table import TableLog
from offpiste.logs.log import open_log
from offpiste.rig.channels import SECONDS_PER_UNIT, ChannelSource, Clock

DART = {
    "81_circles_tape_and_tiles/car_1_Datarecording_09_09_2024_17_58_23steer_neg03_ramp.csv": 6998,
    "82_free_driving_rubbery_floor/car_1_Datarecording_09_25_2024_10_01_57.csv": 1165,
    "83_16_april_2025_slippery_floor/2025-04-16-15-56-43.csv": 834,
}


def table(path: Path, text: str | bytes, **clock: str) -> TableLog:
    path = path / "drive.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return TableLog(path, clock=Clock(**clock))


def column(log: TableLog, field: str) -> list[float]:
    return log.read("", [field]).values[:, 0].tolist()


@pytest.mark.parametrize("name", DART)
def test_dart(data_folder: Path, name: str) -> None:
    log = TableLog(data_folder / "dart" / name)
    topic = log.topics[""]
    assert topic.count == DART[name]
    assert len(topic.fields) == (20 if name.startswith("83") else 14)
    samples = log.read("", ["vicon time", "vicon x"])
    np.testing.assert_array_equal(samples.time, samples.values[:, 0])
    assert (np.diff(samples.time) > 0).all()
    assert np.isfinite(samples.values).all()
    assert len(log.warnings) == (0 if name.startswith("83") else 1)


def test_dart_has_two_columns_of_time(data_folder: Path) -> None:
    path = data_folder / "dart" / "82_free_driving_rubbery_floor" / "car_1_Datarecording_09_25_2024_10_01_57.csv"
    (warning,) = TableLog(path).warnings
    assert warning.startswith("'vicon time' is taken for time, of elapsed time sensors, vicon time; clock.column")
    log = TableLog(path, clock=Clock(column="elapsed time sensors"))
    assert log.warnings == ()
    assert log.read("", ["vicon x"]).time[:3].tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_allclose(log.read("", ["vicon x"]).values[0, 0], -2.8746785765444116, atol=0)


@pytest.mark.parametrize("name", ["t", "T", "time", "Time [s]", "timestamp", "stamp_n", "sec", "t [s]", "%time",
                                  "field.header.timestamp", "gps_tow", "iTOW", "unix_s", "tiempo"])  # fmt: skip
def test_time_is_guessed_by_name(tmp_path: Path, name: str) -> None:
    log = table(tmp_path, f"throttle,section,steer,{name}\n9,9,9,1\n9,9,9,2\n")
    assert log.read("", ["steer"]).time.tolist() == [1.0, 2.0]
    assert log.warnings == ()


@pytest.mark.parametrize(
    ("name", "first", "step", "unit"),
    [
        # By the name, also of a slow logger.
        *((name, 34.0 * factor, 1.01 * factor, unit) for names, factor, unit in (
            (("millis", "ms", "ticks_ms"), 1e3, "ms"), (("t_us", "microseconds"), 1e6, "us"), (["t_ns"], 1e9, "ns"),
        ) for name in names),
        # By the rate, of times of a week and in other languages.
        *((name, 345_600, 0.05, "s") for name in ("GpsTow", "gpsTow", "Tow", "tow_s", "時刻")),
        *((name, 345_600_000, 50, "ms") for name in ("GPS_TOW_ms", "GPSTow", "Temps [ms]")),
        ("Timestamp", 45416.4, 0.02 / 86_400, "d"),
        # By the size of times since 1970, also at rates that suggest another unit.
        ("timestamp", 1.75e12, 1000, "ms"), ("timestamp", 1.75e15, 500, "us"), ("timestamp", 1.75e9, 0.5, "s"),
        ("timestamp", 1.75e18, 2e7, "ns"), ("timestamp", 1.2e9, 2e4, "us"),
    ],
)  # fmt: skip
def test_the_unit_of_a_clock_follows_from_its_name_rate_or_size(tmp_path, name, first, step, unit) -> None:
    rows = "".join(f"{k},{first + step * k!r},{k % 3}\n" for k in range(20))  # an equally steady column precedes it
    log = table(tmp_path, f"odometer,{name},x\n{rows}")
    assert log.clock == Clock(column=name, unit=unit)
    assert TableLog(log.path, clock=Clock(column=name, unit="")).clock == log.clock  # type: ignore[arg-type]
    np.testing.assert_allclose(np.diff(log.stamps("")), step * SECONDS_PER_UNIT[unit], rtol=2e-2, atol=1e-6)


def test_units_in_cells_are_those_of_their_column(tmp_path: Path) -> None:
    rows = "".join(f"{50 * k} ms,{3.6 * k:.1f} km/h,{k} %,{'1 s' if k % 2 else '1 m'}\n" for k in range(20))
    log = table(tmp_path, f"time,speed,pedal,mixed\n{rows}")
    assert log.topics[""].units == {"time": "ms", "speed": "km/h", "pedal": "percent"}
    np.testing.assert_allclose(log.read("", ["speed"]).values[:, 0], 3.6 * np.arange(20))
    np.testing.assert_allclose(np.diff(log.stamps("")), 0.05)
    assert "mixed" in log.topics[""].unread
    with pytest.raises(LogError, match="'1 min' is not a number; fix or empty that cell"):
        table(tmp_path, "time,x\n" + "".join(f"{k} sec,1\n" for k in range(200)) + "1 min,1\n").stamps("")


def test_a_clock_without_a_name_rises_evenly_and_a_count_of_rows_is_none(tmp_path: Path) -> None:
    rows = "".join(f"{k},{0.02 * k + 0.001 * (k % 3):.3f},{k * k % 7}\n" for k in range(50))
    log = table(tmp_path, f"row,gnss,steer\n{rows}")
    assert log.clock.column == "gnss"
    assert log.warnings == ("'gnss' is taken for time, by its even steps",)
    with pytest.raises(LogError, match="no column looks like time"):
        table(tmp_path, "row,steer\n" + "".join(f"{k},{k * k % 7}\n" for k in range(50)))


@pytest.mark.parametrize(
    ("text", "column", "unit", "stamps", "listed"),
    [
        ("t,count,x\n5,1500,1\n6,2500,2\n", "count", "ms", [1.5, 2.5], "t, count, x"),
        # A rig may name a header with its comment sign.
        ("#timestamp [ns],x\n1000000000,1\n2000000000,2\n", "#timestamp [ns]", "", [1, 2], r"timestamp \[ns\], x"),
    ],
)
def test_clock_column_and_unit(tmp_path: Path, text: str, column: str, unit: str, stamps: list, listed: str) -> None:
    assert table(tmp_path, text, column=column, unit=unit).read("", ["x"]).time.tolist() == stamps
    with pytest.raises(LogError, match=f"no column '#stamp' for the clock; available: {listed}"):
        table(tmp_path, text, column="#stamp")


@pytest.mark.parametrize(
    ("cells", "seconds"),
    [
        *((cells, (0.0, 1.0)) for cells in (
            ("2024-01-01T00:00:00", "2024-01-01 00:00:01"), ("2024-01-01T00:00:00Z", "2024-01-01T02:00:01+02:00"),
            ("05/03/2024 11:59:59.5 AM", "05/03/2024 12:00:00.5 PM"), ("3.5.2024 10:11:12,5", "3.5.2024 10:11:13,5"),
            ("2024/05/03 10:11:12.5", "2024/05/03 10:11:13.5"), ("2024-05-03 10:11:12 UTC", "2024-05-03 10:11:13 UTC"),
            ("20240503T101112.5Z", "20240503T101113.5Z"), ("0 days 10:11:12.5", "0 days 10:11:13.5"),
            ("10:11:12.5", "10:11:13.5"), ("23:59:59.5", "00:00:00.5"), ("05/03/2024 23:59:59", "05/04/2024 00:00:00"),
        )),
        # Rows that are late, empty or wrong cost no day.
        (("23:59:59", "00:00:01", "23:59:59.5", "00:00:02"), (0.0, 2.0, 0.5, 3.0)),
        (("3.5. 23:59:59", "4.5. 00:00:01", "3.5. 23:59:59.5", "4.5. 00:00:02"), (0.0, 2.0, 0.5, 3.0)),
        (("23:59:59", "", "00:00:01", "00:00:02"), (0.0, np.nan, 2.0, 3.0)),
        (("14:00:00", "14:00:01", "00:00:00", "14:00:02"), (0.0, 1.0, 36_000.0, 2.0)),
        (("", "3.5. 10:00:00", "3.5. 22:30:00", "4.5. 09:00:00"), (np.nan, 0.0, 45_000.0, 82_800.0)),
        # Digits HHMMSS.
        (("235958.0", "235959.0", "", "000000.0", "000001.0"), (0, 1, np.nan, 2, 3)),
        *(((a, b, c, d), (0, b - a, c - a, d - a)) for a, b, c, d in (
            (95, 96, 97, 98), (98, 99, 100, 101), (10, 11, 100, 101), (110, 111, 112, 113),
        )),
    ],
)  # fmt: skip
def test_dates_and_times_of_the_day_as_stamps(tmp_path: Path, cells: tuple, seconds: tuple) -> None:
    log = table(tmp_path, "Datum/Zeit;x\n" + "".join(f"{cell};{row}\n" for row, cell in enumerate(cells)))
    stamps = log.read("", ["x"]).time
    np.testing.assert_allclose(stamps - stamps[np.isfinite(stamps)][0], seconds, atol=1e-6)


def test_of_two_clocks_a_time_of_the_day_is_the_last_choice(tmp_path: Path) -> None:
    rows = "".join(f"10:11:{k:02d},{1714731060 + k},{k}\n" for k in range(12))
    assert table(tmp_path, f"time,timestamp,x\n{rows}").read("", ["x"]).time[0] == 1714731060.0


def test_text_that_is_no_time_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"row 2 below the header, column 'time': 'noon' is not a time; write seconds"):
        table(tmp_path, "time,x\n10:11:12,1\nnoon,2\n")


def test_cells(tmp_path: Path) -> None:
    log = table(
        tmp_path, "t,x,name,armed\n0,1,a,true\n1,,b,False\n2,nan,,\n3,inf,d,true\n4,-inf,e,true\n5, +7e1 ,f,true\n"
    )
    assert log.topics[""].fields == ("t", "x", "armed")
    np.testing.assert_array_equal(column(log, "x"), [1.0, np.nan, np.nan, np.inf, -np.inf, 70.0])
    np.testing.assert_array_equal(column(log, "armed"), [1.0, 0.0, np.nan, 1.0, 1.0, 1.0])
    with pytest.raises(LogError, match="column 'name' holds text, such as 'a', and no numbers; available: t, x, armed"):
        log.read("", ["name"])


def test_words_on_each_column_may_stand_below_its_unit(tmp_path: Path) -> None:
    header = "Time;PosX;VehSpd;\ns;m;km/h;\nMeasurement time;Position east;Vehicle speed;\n"
    log = table(tmp_path, header + "".join(f"{i / 50};{i};{2 * i};\n" for i in range(60)))
    assert column(log, "PosX") == [float(i) for i in range(60)]
    assert log.topics[""].units["VehSpd"] == "km/h"
    bad = table(tmp_path, header + "".join(f"{i / 50};{'?' if i == 7 else i};{2 * i};\n" for i in range(60)))
    with pytest.raises(LogError, match="row 10 below the header, column 'PosX'"):
        column(bad, "PosX")


@pytest.mark.parametrize(("bad_row", "cell"), [(1, "abc"), (150, "abc"), (7, "1_5"), (60, "N")])
def test_one_bad_cell_is_named_when_its_column_is_read(tmp_path: Path, bad_row: int, cell: str) -> None:
    rows = [f"{i},{i},{cell if i == bad_row else 2 * i}" for i in range(1, 200)]
    log = table(tmp_path, "\n".join(["t,x,y", *rows]))
    assert column(log, "x")[:3] == [1.0, 2.0, 3.0]
    message = (
        rf"drive\.csv: row {bad_row} below the header, column 'y': '{cell}' is not a number; fix or empty that cell"
    )
    with pytest.raises(LogError, match=message):
        log.read("", ["y"])


MOTEC = (
    '"Format","MoTeC CSV File",,,"Workbook","Test"\n"Venue","Quarry",,,"Worksheet",""\n"Vehicle","Buggy"\n'
    '"Sample Rate","50.000","Hz"\n\n"Time","Throttle Pos","Gear"\n"s","%",""\n'
    '\n"0.000","12.5","1"\n"0.020","13.0","1"\n'
)
TUM = "# ground truth trajectory\n# file: 'drive.bag'\n# timestamp tx ty tz qx qy qz qw\n"
POSE = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
UTF_16 = "\ufefft\tLänge\n" + "".join(f"{i}\t{2 * i}\n" for i in range(50)) + "50"
CUT_TABS = ("columns are separated by 'tab'", "the last row is cut off after 1 cells, and left out")
CUT_SPACES = ("columns are separated by spaces", "the last row is cut off after 2 cells, and left out")


@pytest.mark.parametrize(
    ("text", "fields", "values", "warnings"),
    [
        ("t,pedal,x\n0,-,1\n1,--,2\n2,-5.5,3\n", ("t", "pedal", "x"), [np.nan, np.nan, -5.5], ()),
        ("\ufefft;x;note\r\n0;1,5;a, b\r\n1;-2,5;c\r\n", ("t", "x"), [1.5, -2.5],
         ("columns are separated by ';', decimals by ','",)),
        ("t;x\n0;1.5\n", ("t", "x"), [1.5], ("columns are separated by ';'",)),
        ("     t     x  gear\n" + "".join(f"  {0.1 * k:6.2f} {k:5d}   D\n" for k in range(12)) + "  1.20  1",
         ("t", "x", "gear"), range(12), CUT_SPACES),
        (TUM + "".join(f"{0.1 * k:.2f} {k} 0 0 0 0 0 1\n" for k in range(12)), POSE, range(12),
         ("2 lines before the header are left out", *CUT_SPACES[:1])),
        ("% throttle,% brake,t\n1,2,0\n3,4,1\n", ("% throttle", "% brake", "t"), [2, 4], ()),
        *((UTF_16.encode(code), ("t", "Länge"), range(0, 100, 2), CUT_TABS) for code in ("utf-16-le", "utf-16-be")),
        ("gps,gps,gps,imu\nt,x,y,ax\n" + "".join(f"{row},1,2,3\n" for row in range(5)), ("t", "x", "y", "ax"), [1] * 5,
         ("1 lines before the header are left out",)),
        (MOTEC, ("Time", "Throttle Pos", "Gear"), [12.5, 13.0], ("5 lines before the header are left out",)),
    ],
)  # fmt: skip
def test_dialects(tmp_path: Path, text: str | bytes, fields: tuple, values: list, warnings: tuple) -> None:
    log = table(tmp_path, text)
    assert (log.topics[""].fields, log.warnings) == (fields, warnings)
    np.testing.assert_array_equal(column(log, fields[1]), values)
    assert text is not MOTEC or log.topics[""].units == {"Time": "s", "Throttle Pos": "percent"}


def test_a_text_with_rows_of_numbers_is_a_table(tmp_path: Path) -> None:
    (tmp_path / "drive.txt").write_text(TUM + "0.1 1 0 0 0 0 0 1\n" * 9)
    assert open_log(tmp_path / "drive.txt").topics[""].fields == POSE


@pytest.mark.parametrize(("separator", "comment"), [(" ", ""), (" ", "# "), ("\t", "% "), (";", "%"), (",", "// ")])
def test_tables_of_numpy_savetxt(tmp_path: Path, separator: str, comment: str) -> None:
    rows = np.column_stack((0.02 * np.arange(20), np.random.default_rng(0).normal(size=(20, 2))))
    np.savetxt(tmp_path / "drive.csv", rows, delimiter=separator, header=separator.join("txy"), comments=comment)
    log = TableLog(tmp_path / "drive.csv")
    assert log.topics[""].fields == ("t", "x", "y")
    np.testing.assert_array_equal(log.read("", ["x", "y"]).values, rows[:, 1:])


@pytest.mark.parametrize("name", ["x", "#x", "# x"])
def test_a_rig_may_name_a_field_with_the_sign_that_made_its_header_a_comment(tmp_path: Path, name: str) -> None:
    log = table(tmp_path, "#x,t\n5,0\n6,1\n")
    assert read_channel(log, small_rig(), "throttle", ChannelSource(fields=(name,)))[0].values.tolist() == [[5], [6]]


@pytest.mark.parametrize("header", ["date time x y", "# date time x y", "time x y"])
def test_a_stamp_with_a_space_in_it_among_columns_separated_by_spaces(tmp_path: Path, header: str) -> None:
    rows = [
        "2024-05-03 23:59:59.5  1 2",
        "2024-05-04 00:00:00.5 3  4",
        "2024-05-05 00:00:00 5 6",
        "2024-05-05 00:00:01 7",
    ]
    log = table(tmp_path, "\n".join((header, *rows)))
    assert log.topics[""].fields == ("x", "y")
    samples = log.read("", ["x", "y"])
    assert np.diff(samples.time).tolist() == [1.0, 86_399.5]
    np.testing.assert_array_equal(samples.values, [[1, 2], [3, 4], [5, 6]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0.1 1 2 3 0 0 0 1\n0.2 1 2 3 0 0 0 1\n", "no header line above 8 columns of numbers; write the names of the "
         "columns into the first line, such as timestamp tx ty tz qx qy qz qw"),
        ("t pos x pos y\n0.1 1 2\n0.2 1 2\n",
         "5 names above 3 columns separated by spaces; give each column one name without spaces in it"),
        ("throttle,steer\n1,2\n",
         "no column looks like time; name it: `inspect --time COLUMN`, or clock.column in a rig; "
         "available: throttle, steer"),
        ("", "the file is empty, or begins with an empty line; record or export it again"),
        ("t,x", "no row below the header; record or export it again"),
        ("t,x\n\n\n", "no row below the header; record or export it again"),
        ("t,x\n0,1\n1,2,3\n", "Row #3: Expected 2 columns, got 3: 1,2,3; fix that line"),
        ("t,x\n0,1\n1\n2,3\n", "Row #3: Expected 2 columns, got 1: 1; fix that line"),
        ("1,2\n3,4\n", "no header line above 2 columns of numbers; write the names of the columns into the first line"),
        ("t,x,x\n1,2,3\n", "column 'x' appears twice; give every column its own name"),
        (b"t,yaw \x81\n0,1\n", "the text is neither UTF-8 nor cp1252; save it as UTF-8"),
        (b"t,unit\n0,m\n1,m\n2,\x81\n", "the text is neither UTF-8 nor cp1252; save it as UTF-8"),
        ("t,x\n0,1\n".encode("utf-16-le"), "not a text file; save it as UTF-8 text with a header line"),
    ],
)  # fmt: skip
def test_damaged_text(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(LogError) as caught:
        table(tmp_path, text)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{tmp_path / 'drive.csv'}: ")


def test_parquet(tmp_path: Path) -> None:
    path = tmp_path / "drive.parquet"
    columns = {
        "stamp": pa.array([1_704_067_200_000, 1_704_067_200_500, None], pa.timestamp("ms")),
        "gear": pa.array([1, None, -1], pa.int8()),
        "armed": pa.array([True, False, None]),
        "ticks": pa.array([2**60, 2**60 + 4096, 0], pa.int64()),
        "x": pa.array([0.5, np.nan, np.inf]),
        "name": pa.array(["a", "b", "c"]),
        "points": pa.array([[1.0], [], [2.0]]),
    }
    pq.write_table(pa.table(columns), path)
    log = TableLog(path)
    assert log.topics[""].fields == ("stamp", "gear", "armed", "ticks", "x")
    assert (log.topics[""].type, log.topics[""].count) == ("Parquet table", 3)
    samples = log.read("", ["gear", "armed", "ticks", "x"])
    np.testing.assert_array_equal(samples.time, [1704067200.0, 1704067200.5, np.nan])
    expected = [[1, 1, 2.0**60, 0.5], [np.nan, 0, 2.0**60 + 4096, np.nan], [-1, np.nan, 0, np.inf]]
    np.testing.assert_array_equal(samples.values, expected)


def test_an_index_of_timestamps_without_a_name_is_time(tmp_path: Path) -> None:
    """Pandas writes it as the last column, `__index_level_0__`."""
    stamps = pa.array([1_700_000_000_000_000_000, 1_700_000_000_013_000_000], pa.timestamp("ns"))
    pq.write_table(pa.table({"x": [1.0, 2.0], "__index_level_0__": stamps}), tmp_path / "drive.parquet")
    log = TableLog(tmp_path / "drive.parquet")
    assert log.clock.column == "__index_level_0__"
    assert log.read("", ["x"]).time == pytest.approx([1.7e9, 1.7e9 + 0.013], abs=1e-6)


@pytest.mark.parametrize(
    ("columns", "what"),
    [
        ({"t": pa.array([], pa.float64())}, r"a\.parquet: the table has no rows; record or export it again"),
        ({"name": ["a"]}, "no column of numbers; export the quantities as numbers"),
    ],
)
def test_parquet_without_rows_or_numbers(tmp_path: Path, columns: dict, what: str) -> None:
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    with pytest.raises(LogError, match=what):
        TableLog(tmp_path / "a.parquet")


def test_damaged_parquet(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"t": np.arange(1000.0), "x": np.arange(1000.0)}), path)
    whole = path.read_bytes()
    for part in (b"", b"t,x\n0,1\n", whole[: len(whole) // 2], whole[:-1]):
        path.write_bytes(part)
        with pytest.raises(LogError, match=r"a\.parquet: not a readable Parquet file: .*; export it again"):
            TableLog(path)


@pytest.mark.parametrize(
    ("cells", "codes"),
    [
        (("Park", "REVERSE", "neutral", "forward", "drive"), (80, 82, 78, 68, 68)),
        (("R", "N", "1", "2", "1"), (82, 78, 1, 2, 1)),
        (("P", "R", "D", "D", "R"), (80, 82, 68, 68, 82)),
        (("stop", "Stopped", "standstill", "forward", "halt"), (78, 78, 78, 68, 78)),
    ],
)
def test_words_and_numbers_of_gears(tmp_path: Path, cells: tuple[str, ...], codes: tuple[int, ...]) -> None:
    rows = "".join(f"{row},{cell},on\n" for row, cell in enumerate((*cells, *cells)))
    log = table(tmp_path, f"t,gear,mode\n{rows}")
    assert log.topics[""].fields == ("t", "gear")
    assert log.read("", ["gear"]).values[:5, 0].tolist() == list(codes)


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_a_word_that_is_no_gear_is_named(tmp_path: Path, ending: str) -> None:
    way, path = ["forward", "reverse", "crawl", "forward"] * 5, tmp_path / f"a.{ending}"
    columns = {"t": np.arange(20.0), "way": way, "place": ["here"] * 20}
    if ending == "csv":
        rows = zip(*columns.values(), strict=True)
        path.write_text("\n".join(["t,way,place", *(",".join(map(str, row)) for row in rows)]) + "\n", "utf-8")
    else:
        pq.write_table(pa.table(columns), path)
    log = TableLog(path)
    assert log.topics[""].fields == ("t",)
    what = "column 'way' holds words of gears, among which 'crawl' is not known"
    assert log.warnings == (f"{what}: it is left out",)
    with pytest.raises(LogError, match=what):
        log.read("", ["way"])
    with pytest.raises(LogError, match="column 'place' holds text, such as 'here', and no numbers"):
        log.read("", ["place"])


def test_columns_of_structs_are_their_fields(tmp_path: Path) -> None:
    pose = pa.array([{"p": {"x": 1.0, "y": 2.0}, "name": "a"}, {"p": {"x": 3.0, "y": 4.0}, "name": "b"}])
    pq.write_table(pa.table({"t": [0.0, 0.1], "pose": pose}), tmp_path / "drive.parquet")
    log = TableLog(tmp_path / "drive.parquet")
    assert log.topics[""].fields == ("t", "pose.p.x", "pose.p.y")
    assert column(log, "pose.p.y") == [2, 4]


def test_seconds_and_nanoseconds_beside_them_are_one_stamp(tmp_path: Path) -> None:
    text = "stamp_secs,stamp_nsecs,x\n100,980000000,0\n101,0,1\n101,20000000,2\n"
    for log in (table(tmp_path, text), table(tmp_path, text, column="stamp_secs")):
        np.testing.assert_allclose(log.read("", ["x"]).time, [100.98, 101, 101.02])


def test_text_in_parquet_is_read_as_in_csv(tmp_path: Path) -> None:
    times = ["2026-11-27T12:00:00", "2026-11-27T12:00:01", "2026-11-27T12:00:02"]
    gears = pa.array(["D", "R", "D"]).dictionary_encode()
    pq.write_table(pa.table({"time": times, "gear": gears, "x": [1, 2, 3]}), tmp_path / "drive.parquet")
    log = TableLog(tmp_path / "drive.parquet")
    assert np.diff(log.read("", ["x"]).time).tolist() == [1, 1]
    assert column(log, "gear") == [ord("D"), ord("R"), ord("D")]
