"""Intervals, sensor timing, and colours of maps."""

import numpy as np
import pytest

from offpiste.core.errors import LogError
from offpiste.report.figure import png
from offpiste.visualization.map_figure import FEATURED, OBSERVED, SUN, Ground, draw_map, feature_colours, hillshade
from offpiste.visualization.view import parse_stretch
from offpiste.visualization.view_log import draw_sensors, gaps


@pytest.mark.parametrize(
    ("text", "wanted"), [("", (0, np.inf)), ("2:3.5", (2, 3.5)), ("7:", (7, np.inf)), (":4", (0, 4))]
)
def test_a_stretch(text: str, wanted: tuple[float, float]) -> None:
    assert parse_stretch(text) == wanted


@pytest.mark.parametrize("text", ["5", "a:b", "-1:2", "nan:1", "1:2:3", "2:2"])
def test_what_is_no_stretch_is_refused(text: str) -> None:
    with pytest.raises(LogError, match="A:B"):
        parse_stretch(text)


def test_gaps_are_longer_than_three_usual_intervals() -> None:
    np.testing.assert_array_equal(gaps(np.array([0.0, 1.0, 2.0, 4.9, 6.0, 10.0])), [0, 0, 0, 0, 1])
    assert gaps(np.array([1.0])).shape == (0,)
    draw_sensors({"poses": np.arange(5.0), "silent": np.zeros(0), "once": np.ones(1)}, (0.0, np.inf))


def ground_of(elevation: np.ndarray) -> Ground:
    nothing = np.full(elevation.shape, np.nan)
    components = np.full((*elevation.shape, 3), np.nan)
    known = np.full(elevation.shape, OBSERVED)
    return Ground(np.zeros(2), 0.5, elevation, components, nothing, nothing, known)


def test_slopes_towards_the_light_are_bright() -> None:
    """The light comes from the upper left: falling to the left is towards it, and rising to the top is away from it."""
    rising, sun = np.tile(0.5 * np.arange(6), (4, 1)), SUN / np.linalg.norm(SUN)
    cases = ((0 * rising, (0, 0, 1)), (rising, (-1, 0, 1)), (-rising, (1, 0, 1)), (rising.T, (0, -1, 1)))
    for elevation, normal in cases:
        np.testing.assert_allclose(hillshade(ground_of(elevation)), np.dot(normal, sun) / np.linalg.norm(normal))


def test_features_have_colours_and_the_rest_is_grey() -> None:
    ground = ground_of(np.zeros((2, 3)))
    ground.known[0, 0], ground.components[0, 0] = FEATURED, (-1, 0, 1)
    ground.known[1, 2] = 0
    limits = np.array([[-1.0, -1, -1], [1, 1, 1]])
    picture = feature_colours(ground, limits)
    np.testing.assert_allclose(picture[0, 0], (0, 0.5, 1), atol=0.01)
    assert np.ptp(picture[0, 1]) == 0
    assert picture[1, 2].min() > 0.9
    assert (feature_colours(ground, None)[0, 0] == feature_colours(ground, None)[0, 1]).all()


def test_a_map_of_nothing_or_of_one_cell_can_be_drawn() -> None:
    nothing = ground_of(np.full((3, 4), np.nan))
    nothing.known[:] = 0
    for ground in (nothing, ground_of(np.full((1, 1), 2.0))):
        assert len(png(draw_map(ground, np.full((3, 4, 2), np.nan), None))) > 1000
