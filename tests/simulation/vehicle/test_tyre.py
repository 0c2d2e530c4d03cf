"""Tyres: where a wheel meets the ground, and forces of the brush model."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from offpiste.native.library import entry
from offpiste.simulation.vehicle.parameters import RECORD, load_vehicle

P = load_vehicle()
RECORDED = P.as_record()

_ground_under = entry("ground_under", "f8", int, int, float, float, float, "f8", "f8", RECORD, "f8")
_touch = entry("touch", "f8", "f8", "f8", float, "f8")
_brush_force = entry("brush_force", *[float] * 6, "f8")
_suspension_force = entry("suspension_force", *[float] * 7, RECORD, returns=float)
relax = entry("relax", *[float] * 5, returns=float)


def brush_force(*arguments):
    force = np.empty(2)
    _brush_force(*arguments, force)
    return force


def plane(a, b):
    x, y = np.arange(41) * 0.25, np.arange(31)[:, None] * 0.25
    return a * x + b * y


@pytest.mark.parametrize("heading", [0.0, 0.7, 2.0, -1.5])
@pytest.mark.parametrize(("a", "b"), [(0.0, 0.0), (0.5, 0.0), (0.0, 0.3), (-0.4, 0.7)])
def test_plane_is_found_whatever_the_heading(a, b, heading):
    centre, forward = np.array((5.1, 3.3, 9.0)), np.array((np.cos(heading), np.sin(heading), 0.2))
    elevation, found = plane(a, b), np.empty(4)
    _ground_under(elevation, *elevation.shape, 0.0, 0.0, 0.25, centre, forward, RECORDED, found)
    height, *normal = found
    assert height == pytest.approx(a * 5.1 + b * 3.3)
    np.testing.assert_allclose(normal, np.array((-a, -b, 1)) / np.sqrt(1 + a * a + b * b), atol=1e-9)


def test_contact_on_a_slope_is_below_the_centre_along_the_normal():
    normal = np.array((-0.6, 0.0, 0.8))
    centre = np.array((1.0, 2.0, 3.0))
    ground = 3.0 - 0.35 / 0.8  # the plane lies 0.35 m from the centre
    found = np.empty(4)
    _touch(centre, np.array((ground, *normal)), np.array((0.0, 1.0, 0.0)), 0.37, found)
    compression, *contact = found
    assert compression == pytest.approx(0.02)
    np.testing.assert_allclose(contact, centre - 0.35 * normal, atol=1e-12)


def force(travel, rate=0.0, other=None):
    other = travel if other is None else other
    return _suspension_force(travel, rate, other, 20e3, 1500.0, 5e3, 2000.0, RECORDED)


def test_spring_damper_bar_and_stops():
    assert force(0.0) == pytest.approx(2000.0)
    assert force(0.05) == pytest.approx(3000.0)
    assert force(0.05, other=0.0) == pytest.approx(3250.0)
    assert force(0.0, 1.0) - 2000 == pytest.approx(1500 * (1 - P.damper_asymmetry))
    assert force(0.0, -1.0) - 2000 == pytest.approx(-1500 * (1 + P.damper_asymmetry))
    assert force(P.bump_travel + 0.01) - force(P.bump_travel) > 0.01 * 20e3 + 1000
    assert force(-P.droop_travel - 0.01) == pytest.approx(-0.01 * P.stop_stiffness)


slips = st.floats(-3, 3)
frictions = st.floats(0.1, 1.0)
loads = st.floats(1, 20e3)


@given(slips, slips, frictions, loads)
def test_force_opposes_slip_and_stays_within_friction(slip_x, slip_y, friction, load):
    x, y = brush_force(slip_x, slip_y, 9.0, 6.0, friction, load)
    assert x * slip_x <= 0
    assert y * slip_y <= 0
    assert np.hypot(x, y) <= friction * load * (1 + 1e-12)


def test_whole_patch_slides_at_three_frictions_over_stiffness():
    # Fiala: tan(alpha_sl) = 3 mu F_z / C_alpha.
    sliding = 3 * 0.6 / 6.0
    assert brush_force(0.0, sliding, 9.0, 6.0, 0.6, 1000.0)[1] == pytest.approx(-600.0)
    assert brush_force(0.0, 0.5 * sliding, 9.0, 6.0, 0.6, 1000.0)[1] == pytest.approx(-600.0 * 0.875)
    assert brush_force(0.0, 9 * sliding, 9.0, 6.0, 0.6, 1000.0)[1] == pytest.approx(-600.0)


def test_deflection_relaxes_over_its_length_to_the_steady_slip():
    # du/dt = v_s - V u / length: (1 - 1/e) of v_s length / V after one length.
    u, dt = 0.0, 1e-4
    for _ in range(round(0.35 / 5.0 / dt)):
        u = relax(u, 0.5, 5.0, 0.35, dt)
    assert u / 0.35 == pytest.approx(0.5 / 5.0 * (1 - np.exp(-1)), rel=2e-3)
