"""Layouts come with a rig that knows the vehicle's own body; a drive that ends too early is driven again."""

import numpy as np
import pytest

import experiments.illnesses.sensors.drives as drives
from experiments.illnesses.sensors.drives import CAMERA, LAYOUTS, LIDAR, drive_of
from offpiste.perception.camera import mask_from_polygons
from offpiste.simulation.sensors.camera import Camera
from offpiste.simulation.simulate import DriveSummary


@pytest.mark.parametrize("name", LAYOUTS)
def test_the_rig_masks_the_own_body(name):
    rig, (settings,) = LAYOUTS[name].rig(), LAYOUTS[name].suite().cameras
    assert (list(rig.cameras), list(rig.lidars)) == ([CAMERA], [LIDAR])
    width, height = settings.model.size
    mask = mask_from_polygons(rig.cameras[CAMERA].own_body, width, height)
    camera = Camera(settings)
    own = np.isfinite(camera.in_rows(camera.own).distance).reshape(height, width)
    assert mask[own].all()
    assert mask.mean() < own.mean() + 0.02


def test_a_short_drive_is_driven_again_and_a_kept_one_is_found(monkeypatch, tmp_path):
    seconds = [3.0, 40.0]

    def record(settings, world, vehicle, start, controller, out, *, steps, suite):
        out.write_bytes(b"drive")
        assert steps == 2000
        return DriveSummary(out, seconds.pop(0), 100.0, (), np.zeros((1, 2)), np.zeros(1))

    monkeypatch.setattr(drives, "record", record)
    first = drive_of(4, tmp_path)
    assert seconds == []
    assert (first.layout, first.path.name) == ("mast", f"sensors-000004-{first.behaviour}-mast.mcap")
    assert drive_of(4, tmp_path) == first
    assert [path.name for path in tmp_path.iterdir()] == [first.path.name]
