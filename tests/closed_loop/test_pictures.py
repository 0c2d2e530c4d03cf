"""Pictures of drives along courses."""

import numpy as np
import pytest

from offpiste.closed_loop import pictures
from offpiste.closed_loop.pictures import course_picture
from offpiste.closed_loop.scores import Trace
from offpiste.planning.course import Course


@pytest.mark.parametrize(("wide", "tall"), [(5, 140), (59, 100), (130, 20)])
def test_nothing_is_cut_off_whatever_shape_the_course_has(wide, tall, monkeypatch):
    plain = {"aspect": "equal", "xlabel": "x [m]", "ylabel": "y [m]"}
    monkeypatch.setattr(pictures, "draw_top_view", lambda world, axes: axes.set(**plain))
    along, zeros = np.linspace(-1, 1, 30), np.zeros(30)
    path = np.stack((wide * np.sin(3 * along), tall * along), axis=1)
    trace = Trace(path + 0.5, zeros + 5, zeros, zeros, zeros, zeros + 0.1)
    figure = course_picture(None, Course(path, np.full(30, 7.0)), trace, [], "mojave, seed 12: dc", scored=29)
    figure.draw_without_rendering()
    boxes = [axes.get_tightbbox() for axes in figure.axes] + [figure.legends[0].get_window_extent()]
    assert min(box.x0 for box in boxes) >= 0
    assert max(box.x1 for box in boxes) <= figure.bbox.width
