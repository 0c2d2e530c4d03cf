"""Edges of depth and of brightness: a post before a wall, worked out by hand, and its picture shifted."""

import numpy as np
import pytest

from experiments.marv import depth_edges, edge_score, image_edges

STEP = np.deg2rad(0.35)


def scan(distance: np.ndarray, *, rows: int = 3) -> np.ndarray:
    """One ring a row, one point a column, straight ahead is azimuth 0."""
    azimuth = (np.arange(len(distance)) - len(distance) // 2) * STEP
    rings = []
    for row in range(rows):
        elevation = row * 2 * STEP
        flat = np.column_stack((np.cos(azimuth), np.sin(azimuth))) * np.cos(elevation)
        rings.append(distance[:, None] * np.column_stack((flat, np.full(len(distance), np.sin(elevation)))))
    return np.concatenate(rings)


def test_the_sides_of_a_post_are_edges_by_the_root_of_the_step():
    distance = np.full(41, 14.0)
    distance[15:26] = 5.0
    found = depth_edges(scan(distance)).reshape(3, 41)
    edges = np.flatnonzero(found[0])
    np.testing.assert_allclose(found, np.tile(found[0], (3, 1)))
    # Up to three columns away: the nearest neighbour decides, so only the outermost column of the post is one.
    assert edges.tolist() == [15, 25]
    np.testing.assert_allclose(found[0, edges], 3.0, atol=1e-9)


def test_the_far_side_and_small_steps_are_no_edges():
    distance = np.full(41, 14.0)
    distance[15:26] = 13.5
    assert not depth_edges(scan(distance)).any()
    assert depth_edges(scan(distance), least=0.4).any()
    assert depth_edges(np.zeros((0, 3))).shape == (0,)


def test_a_hole_without_echo_is_looked_across():
    distance = np.full(41, 14.0)
    distance[15:26] = 5.0
    points = scan(distance).reshape(3, 41, 3)
    left_out = np.delete(points, [13, 14], axis=1)
    found = depth_edges(left_out.reshape(-1, 3)).reshape(3, 39)
    assert np.flatnonzero(found[1]).tolist() == [13, 23]


def test_the_score_is_highest_where_edges_agree():
    image = np.full((120, 200, 3), 60, np.uint8)
    image[:, 80:120] = 200
    edges = image_edges(image)
    rows = np.arange(10, 110, 4.0)
    strength = np.ones(2 * len(rows))
    scores = {}
    for shift in (-12, -4, 0, 4, 12):
        pixels = np.concatenate([np.column_stack((np.full(len(rows), x + shift), rows)) for x in (79.5, 119.5)])
        scores[shift] = edge_score(edges, pixels, strength)
    assert max(scores, key=lambda shift: scores[shift]) == 0
    assert scores[0] > 5 * scores[12]
    assert scores[4] > 2 * scores[12]


def test_by_chance_the_score_is_one_and_without_edges_it_is_unknown():
    rng = np.random.default_rng(0)
    edges = image_edges(rng.integers(0, 255, (100, 160, 3)).astype(np.uint8))
    pixels = rng.uniform((0, 0), (159, 99), (4000, 2))
    assert edge_score(edges, pixels, rng.uniform(0, 1, 4000)) == pytest.approx(1.0, abs=0.03)
    assert np.isnan(edge_score(edges, pixels, np.zeros(4000)))
