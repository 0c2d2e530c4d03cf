"""Scenes of a log: nothing in them is from later, and they have the gear that was driven in."""

from dataclasses import replace

import numpy as np
import pytest

import offpiste
from factories import circle_rows
from offpiste.core.conventions import CONTROL
from offpiste.core.errors import LogError
from offpiste.logs import Log
from offpiste.mapping import replay
from offpiste.runtime import scene
from shared_drives import drive_with_sensors


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    return offpiste.open_log(drive_with_sensors(tmp_path_factory.mktemp("scene") / "drive.mcap"))


def test_a_scene_holds_no_measurement_from_after_its_last_row(log, monkeypatch):
    moments = []

    def recorded(*arguments: object, **options: object) -> object:
        for moment in replay.replay(*arguments, **options):
            moments.append(moment)
            yield moment

    monkeypatch.setattr(scene, "replay", recorded)
    planner = offpiste.load_planner("pretrained:proving-ground/b")
    for seconds in (1.0, 1.03, 1.06):
        found = offpiste.read_scene(log, offpiste.load_rig("proving_ground"), planner, seconds)
        assert moments[-1].placed <= found.time
        assert 0 <= found.time - log.stamps("/odometry")[0] - seconds < 0.15
    yaw = found.state[2]  # places ahead are given in the body frame
    np.testing.assert_allclose(found.ahead(2.0) - found.state[:2], (2 * np.cos(yaw), 2 * np.sin(yaw)), atol=1e-9)
    np.testing.assert_allclose(found.ahead(0.0, left=1.0) - found.state[:2], (-np.sin(yaw), np.cos(yaw)), atol=1e-9)


@pytest.mark.parametrize(("seconds", "said"), [(0.0, "no complete history"), (-1.0, "no scan"), (9.0, "poses end")])
def test_a_time_without_a_scene_is_refused(log, seconds, said):
    planner = offpiste.load_planner("pretrained:proving-ground/b")
    with pytest.raises(LogError, match=said):
        offpiste.read_scene(log, offpiste.load_rig("proving_ground"), planner, seconds)


def test_the_gear_of_the_log_is_that_of_its_rows():
    rows = circle_rows(100)
    forward = scene.track_of(rows, CONTROL, 50)
    control = np.concatenate((rows.control_causal, np.full((100, 1), -1, np.float32)), axis=1)
    geared = replace(rows, control=control, control_causal=control)
    reverse = scene.track_of(geared, (*CONTROL, "gear"), 50)
    assert (forward.gear == 1).all()
    assert (reverse.gear == -1).all()
    assert forward.control.shape == reverse.control.shape == (11, 3)
    np.testing.assert_array_equal(forward.control, reverse.control)
    np.testing.assert_allclose(forward.state[-1, :2], rows.state_causal[50, :2] + rows.origin)
