"""Hazards along arcs on shapes whose slopes are known."""

import numpy as np
import pytest

from offpiste.simulation.driver.route import FAR, VisibleTerrain, hazards_along_arcs
from simulation.drives import flat_world

SIZE = (2.0, 1.2, 1.5)
"""Wheelbase, track, middle to nose."""


def hazards_from(world, *, x=0.0, y=0.0, yaw=0.0, length=10.0, curvatures=(0.0,), margin=8.0):
    return hazards_along_arcs(
        VisibleTerrain.of(world), np.array(curvatures), x=x, y=y, yaw=yaw, length=length, size=SIZE, margin=margin
    )


def test_an_arc_ends_where_a_circle_does():
    curvatures = np.array([-0.2, 0.0, 0.05, 0.2])
    hazards = hazards_from(flat_world(), x=3.0, y=-2.0, yaw=0.7, length=12.0, curvatures=curvatures)
    turn = curvatures * 12
    with np.errstate(invalid="ignore", divide="ignore"):
        ahead = np.where(curvatures == 0, 12.0, np.sin(turn) / curvatures)
        left = np.where(curvatures == 0, 0.0, (1 - np.cos(turn)) / curvatures)
    c, s = np.cos(0.7), np.sin(0.7)
    # Chords are shorter than arcs: by 1 - sinc of half a step's turn.
    np.testing.assert_allclose(
        hazards.end, np.stack((3 + c * ahead - s * left, -2 + s * ahead + c * left), -1), atol=0.01
    )


@pytest.mark.parametrize(
    ("yaw", "climb", "descent", "lean"), [(0.0, 0.2, 0.0, 0.1), (np.pi, 0.0, 0.2, 0.1), (np.pi / 2, 0.1, 0.0, 0.2)]
)
def test_a_plane_is_climbed_or_leaned_on(yaw, climb, descent, lean):
    hazards = hazards_from(flat_world(slope=0.2, side_slope=0.1), yaw=yaw)
    for value, wanted in (
        (hazards.climb, climb),
        (hazards.descent, descent),
        (hazards.lean, lean),
        (hazards.vertical_curvature, 0.0),
    ):
        np.testing.assert_allclose(value, [wanted], atol=1e-6)
    np.testing.assert_allclose(hazards.protrusion, [0.0], atol=1e-6)


def test_a_ridge_touches_the_belly_and_a_wall_the_nose():
    # A roof along y, 30 % steep, its ridge at x = 6: with the axles 1 m to both sides the ridge is 0.3 m above them.
    ridge = flat_world(bumps=lambda x: -0.3 * np.abs(x - 6.0), resolution=0.25)
    np.testing.assert_allclose(hazards_from(ridge, length=12.0).protrusion, [0.3], atol=0.05)
    wall = flat_world(bumps=lambda x: np.where(x > 9.0, 1.0, 0.0), resolution=0.25)
    # The nose is at 7 + 1.5 m while all wheels still stand before the wall.
    assert hazards_from(wall, length=7.0).protrusion[0] < 0.01
    assert hazards_from(wall, length=8.5).protrusion[0] > 0.5


def test_a_bump_curves_the_path():
    # z = x^2 / 2r has the curvature 1/r.
    hazards = hazards_from(flat_world(bumps=lambda x: x**2 / 100, resolution=0.25), x=-4.0, length=8.0)
    np.testing.assert_allclose(hazards.vertical_curvature, [0.02], rtol=0.05)


def test_trees_and_the_border_count():
    world = flat_world(trees=[(6.0, 0.0, 0.25), (300.0, 0.0, 0.5)])
    hazards = hazards_from(world, curvatures=(0.0, 0.2))
    np.testing.assert_allclose(hazards.clearance[0], -0.25, atol=0.31)  # points are 0.6 m apart
    assert hazards.clearance[1] > 1.5
    assert hazards_from(flat_world()).clearance[0] == FAR
    assert hazards_from(world, x=50.0).clearance[0] == FAR
    assert hazards_from(world, y=0.0).border_overlap[0] == 0.0
    np.testing.assert_allclose(
        hazards_from(world, y=45.0, yaw=np.pi / 2).border_overlap, [3.0], atol=0.01
    )  # border at 60 m
    np.testing.assert_allclose(hazards_from(world, x=-100.0, yaw=np.pi, length=20.0).border_overlap, [8.0], atol=0.01)


def test_slopes_along_a_line():
    terrain = VisibleTerrain.of(flat_world(bumps=lambda x: np.where(x > 10, 0.3 * (x - 10), 0.0), resolution=0.5))
    line = np.stack((np.arange(0, 20.25, 0.5), np.zeros(41)), axis=-1)
    np.testing.assert_allclose(terrain.max_slope(line), 0.3, atol=1e-6)
    np.testing.assert_allclose(terrain.max_slope(line[::-1]), 0.15, atol=1e-6)
    across = np.stack((np.full(41, 12.0), line[:, 0]), axis=-1)
    np.testing.assert_allclose(terrain.max_slope(across), 0.3, atol=1e-6)  # driven on the slant
    assert line[terrain.first_climb(line, 0.2), 0] == pytest.approx(9.5)  # from 9.5 to 11.5 m it climbs by 0.45 m
    assert terrain.first_climb(line, 0.35) == len(line)
    assert terrain.first_climb(line[:1], 0.2) == 1
