import numpy as np
import pytest

from offpiste.simulation.vehicle.forces import suspension_force
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.vehicle.tyre import contact_axes, ground_under, normal_load, touch

P = load_vehicle().as_record()


def plane(a, b):
    x, y = np.arange(41) * 0.25, np.arange(31)[:, None] * 0.25
    return a * x + b * y


@pytest.mark.parametrize("heading", [0.0, 0.7, 2.0, -1.5])
@pytest.mark.parametrize(("a", "b"), [(0.0, 0.0), (0.5, 0.0), (0.0, 0.3), (-0.4, 0.7)])
def test_plane_is_found_whatever_the_heading(a, b, heading):
    forward = (np.cos(heading), np.sin(heading), 0.2)
    height, normal = ground_under(plane(a, b), 0.0, 0.0, 0.25, (5.1, 3.3, 9.0), forward, P)
    assert height == pytest.approx(a * 5.1 + b * 3.3)
    np.testing.assert_allclose(normal, np.array((-a, -b, 1)) / np.sqrt(1 + a * a + b * b), atol=1e-9)


def test_tyre_envelops_a_ridge():
    elevation = plane(0.0, 0.0)
    elevation[:, 20] = 0.06
    height, _ = ground_under(elevation, 0.0, 0.0, 0.25, (5.0, 3.0, 9.0), (1.0, 0.0, 0.0), P)
    assert 0.03 < height < 0.06


def test_contact_on_a_slope_is_below_the_centre_along_the_normal():
    normal = np.array((-0.6, 0.0, 0.8))
    centre = np.array((1.0, 2.0, 3.0))
    ground = 3.0 - 0.35 / 0.8  # the plane lies 0.35 m from the centre
    compression, contact = touch(tuple(centre), ground, tuple(normal), (0.0, 1.0, 0.0), 0.37)
    assert compression == pytest.approx(0.02)
    np.testing.assert_allclose(contact, centre - 0.35 * normal, atol=1e-12)


def test_leaning_wheel_reaches_further():
    compression, _ = touch((0.0, 0.0, 0.35), 0.0, (0.0, 0.0, 1.0), (0.0, np.cos(0.3), np.sin(0.3)), 0.37)
    assert compression == pytest.approx(0.37 - 0.35 / np.cos(0.3))


def test_load_never_pulls():
    assert normal_load(-0.01, 0.0, P) == 0.0
    assert normal_load(0.001, -5.0, P) == 0.0
    assert normal_load(0.02, 0.0, P) == pytest.approx(0.02 * P.tyre_stiffness)
    assert normal_load(P.rim_deflection + 0.01, 0.0, P) == pytest.approx(
        (P.rim_deflection + 0.01) * P.tyre_stiffness + 0.01 * P.rim_stiffness
    )


def test_axes_are_right_handed_and_lie_in_the_ground():
    normal = np.array((-0.36, 0.48, 0.8))
    forward, left = (np.array(a) for a in contact_axes(tuple(normal), (0.0, 1.0, 0.0)))
    np.testing.assert_allclose((forward @ normal, left @ normal, forward @ left), 0, atol=1e-12)
    np.testing.assert_allclose(np.cross(forward, left), normal, atol=1e-12)
    assert forward[0] > 0
    assert left[1] > 0


def force(travel, rate=0.0, other=None):
    other = travel if other is None else other
    return suspension_force(travel, rate, other, 20e3, 1500.0, 5e3, 2000.0, P)


def test_spring_damper_bar_and_stops():
    assert force(0.0) == pytest.approx(2000.0)
    assert force(0.05) == pytest.approx(3000.0)
    assert force(0.05, other=0.0) == pytest.approx(3250.0)
    assert force(0.0, 1.0) - 2000 == pytest.approx(1500 * (1 - P.damper_asymmetry))
    assert force(0.0, -1.0) - 2000 == pytest.approx(-1500 * (1 + P.damper_asymmetry))
    assert force(P.bump_travel + 0.01) - force(P.bump_travel) > 0.01 * 20e3 + 1000
    assert force(-P.droop_travel - 0.01) == pytest.approx(-0.01 * P.stop_stiffness)
