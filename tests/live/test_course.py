"""Courses from files, messages and goals; what is none is named."""

from types import SimpleNamespace as Message

import numpy as np
import pytest

from live.made_up_robot import RIG
from offpiste.core.errors import LiveError
from offpiste.core.geometry import local_from_geographic
from offpiste.live.course import course_from_message, course_to, read_course
from offpiste.rig.rig import parse_rig

METRIC = parse_rig(RIG, where="test")


def written(folder, text):
    (folder / "course.csv").write_text(text)
    return folder / "course.csv"


def test_a_table_with_and_without_speeds(tmp_path):
    course = read_course(written(tmp_path, "x,y,speed\n0,0,2\n3,4,3\n"), 9.0, METRIC)
    np.testing.assert_array_equal(course.path, [[0, 0], [3, 4]])
    np.testing.assert_array_equal(course.speed, [2, 3])
    course = read_course(written(tmp_path, "y,x\n0,0\n4,3\n4,3\n"), 9.0, METRIC)
    np.testing.assert_array_equal(course.path, [[0, 0], [3, 4]], "points that repeat count once")
    np.testing.assert_array_equal(course.speed, [9, 9])


def test_a_table_that_excel_saved(tmp_path):
    course = read_course(written(tmp_path, "\ufeffx,y\n0,0\n3,4\n"), 9.0, METRIC)
    np.testing.assert_array_equal(course.path, [[0, 0], [3, 4]])


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "fewer than two points"),
        ("x,y\n1,2\n", "fewer than two points"),
        ("x,y\n1,2\n1.01,2\n", "fewer than two points"),
        ("a,b\n1,2\n3,4\n", "without a number: 'x'"),
        ("x,y\n1,2\nfar,4\n", "without a number"),
        ("x,y\n1,2\nnan,4\n", "no place"),
        ("lat,lon\n48.1,11.5\n48.2,11.5\n", "does not say where x = y = 0"),
        ("x,y,speed\n1,2,0\n3,4,1\n", "its speed is none"),
        ("x,y,speed\n1,2,99\n3,4,1\n", "its speed is none"),
    ],
)
def test_what_is_no_course_is_named(tmp_path, text, what):
    with pytest.raises(LiveError, match=what) as raised:
        read_course(written(tmp_path, text), 3.0, METRIC)
    assert "course.csv" in str(raised.value)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(LiveError, match="no course: No such file") as raised:
        read_course(tmp_path / "none.csv", 3.0, METRIC)
    assert str(raised.value).count("none.csv") == 1


@pytest.mark.parametrize(("axes", "away"), [("z up", (0, 1)), ("ned", (1, -1))])
def test_a_table_of_latitudes_and_longitudes(tmp_path, axes, away):
    entry = '[channels.position]\nunit = "lat lon"\norigin = [48.0, 11.0]\n'
    text = RIG.replace("[channels.position]\n", entry).replace("[motion]\n", "") + f'\n[motion]\naxes = "{axes}"\n'
    earth = parse_rig(text, where="test")
    course = read_course(written(tmp_path, "lat,lon,speed\n48,11,2\n48.001,11,3\n"), 9.0, earth)
    north = local_from_geographic(np.array([[48.001, 11.0]]), (48.0, 11.0))[0, 1]
    assert north == pytest.approx(111.2, abs=0.1), "a thousandth of a degree"
    expected = [[0, 0], (0, north) if axes == "z up" else (north, 0)]
    np.testing.assert_allclose(course.path, expected, atol=1e-6)
    np.testing.assert_array_equal(course.speed, [2, 3])
    with pytest.raises(LiveError, match=r"km from channels\.position\.origin"):
        read_course(written(tmp_path, "lon,lat\n48,11\n48.001,11\n"), 9.0, earth)
    with pytest.raises(LiveError, match="no place"):
        read_course(written(tmp_path, "lat,lon\n480,11\n48.001,11\n"), 9.0, earth)


def test_a_path_message_and_a_goal():
    def pose(x, y):
        return Message(pose=Message(position=Message(x=x, y=y)))

    def path(*poses, frame=""):
        return Message(header=Message(frame_id=frame), poses=poses)

    there = path(pose(0.0, 1.0), pose(5.0, 1.0), frame="map")
    for frame in ("", "map"):
        course = course_from_message(there, 2.0, "/plan", frame)
        np.testing.assert_array_equal(course.path, [[0, 1], [5, 1]])
    with pytest.raises(LiveError, match="a path in 'map', the vehicle's poses are in 'odom'"):
        course_from_message(there, 2.0, "/plan", "odom")
    with pytest.raises(LiveError, match="topic '/plan'"):
        course_from_message(path(), 2.0, "/plan")
    course = course_to(np.array((8.0, 0.0)), np.zeros(2), 2.0)
    np.testing.assert_array_equal(course.path, [[0, 0], [8, 0]])
    with pytest.raises(LiveError, match="the goal"):
        course_to(np.zeros(2), np.zeros(2), 2.0)
