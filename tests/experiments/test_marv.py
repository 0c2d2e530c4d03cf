"""The forest frame: points fall on what they hit, and its map fits the place; edges of depth and of brightness."""

import numpy as np
import pytest

from experiments.map_picture import map_picture
from experiments.marv import (
    CAMERAS,
    Frame,
    depth_edges,
    edge_score,
    edge_scores,
    fit_extractor,
    image_edges,
    overlays,
    read_frame,
    terrain,
)
from offpiste.errors import LogError
from offpiste.perception.backbones import open_backbone
from offpiste.perception.projection import project

FRONT, LEFT = CAMERAS.index("camera_front"), CAMERAS.index("camera_left")
PITCH, YAW = 0, 1
STEP = np.deg2rad(0.35)


@pytest.fixture(scope="module")
def frame(data_folder) -> Frame:
    folder = data_folder / "monoforce_marv"
    if not folder.is_dir():
        pytest.skip(f"no forest frame: {folder}")
    return read_frame(folder)


@pytest.fixture(scope="module")
def layers(frame):
    return terrain(frame, fit_extractor(frame, open_backbone("filterbank")))


def test_every_camera_shows_points_and_they_are_drawn(frame):
    for view, image, drawn in zip(frame.views, frame.images, overlays(frame), strict=True):
        assert project(frame.points_body, [view]).seen.sum() > 5000
        assert 0.01 < (drawn != image).any(axis=2).mean() < 0.2


def test_trunks_are_where_the_points_say(frame):
    """By eye, in the rectified images: the middle of the big trunk and what is left of it."""
    found = project(frame.points_body, [frame.views[FRONT]])
    x, y = found.pixel.T
    trunk = found.distance[found.seen & (x > 800) & (x < 850) & (y > 20) & (y < 120)]
    beside = found.distance[found.seen & (x > 650) & (x < 770) & (y > 60) & (y < 120)]
    assert np.ptp(trunk) < 0.5
    assert np.median(trunk) < 0.7 * np.median(beside)


def test_depth_edges_fall_on_image_edges(frame):
    """Where there are trunks: the front and the left camera see some, the others brushwood only."""
    turns = (-2.0, -1.0, 0.0, 1.0, 2.0)
    scores = edge_scores(frame, turns)
    for turn in (-2.0, -1.0, 1.0, 2.0):
        wrong = scores[FRONT, :, turns.index(turn)]
        assert scores[FRONT, PITCH, 2] > wrong[PITCH] + 0.04
        assert scores[FRONT, YAW, 2] > wrong[YAW] + 0.04
    # The left one is sharpest 0.75 degrees to the right, and trunks say the same by eye: its mounting is that far off,
    # or the robot turned between scan and image.
    assert turns[int(scores[LEFT, YAW].argmax())] == 1.0
    mean = scores.mean(axis=0)
    assert min(mean[PITCH, 2], mean[YAW, 2]) > max(mean[:2, 0].max(), mean[:2, -1].max())


def test_the_map_is_bare_ahead_and_brushwood_to_the_right(layers):
    ny, nx = layers.elevation.shape
    y, x = (
        layers.origin[axis] + layers.resolution * index for axis, index in zip((1, 0), np.mgrid[:ny, :nx], strict=True)
    )
    ahead = (x > 0.8) & (x < 2) & (np.abs(y) < 0.6)
    right = (np.abs(x) < 2) & (y < -1.5) & (y > -3.5)
    assert layers.valid[ahead].mean() > 0.9
    assert np.median(layers.obstacle_height[ahead & layers.known]) < 0.15
    assert np.median(layers.obstacle_height[right & layers.known]) > 0.5
    assert np.isfinite(layers.features[layers.valid]).all()
    # The left camera shows the same earth under a tree ahead: it looks alike, from above too.
    left = (x > 0.8) & (x < 2.4) & (y > 1) & (y < 3)
    earth, alike, brush = (layers.features[part & layers.valid][:, :3].mean(axis=0) for part in (ahead, left, right))
    assert np.linalg.norm(earth - alike) < 0.6 * np.linalg.norm(earth - brush)


def test_a_picture_has_the_robot_in_its_middle_and_y_upwards(layers):
    picture = map_picture(layers, np.zeros(2), reach=4.0, pixels=1)
    assert picture.shape == (41, 84, 3)
    assert picture[20, 20].tolist() == [255, 0, 0]
    known = layers.known & (np.abs(layers.elevation) < 100)
    at = np.round(-layers.origin / layers.resolution).astype(int)
    up = known[at[1] + 6 : at[1] + 20, at[0] - 20 : at[0] + 21][::-1]
    assert ((picture[1:15, 43:] > 0).any(axis=2) == up).mean() > 0.98


def test_a_folder_without_the_frame_ends_in_one_line(tmp_path):
    with pytest.raises(LogError, match=r"no clouds.*give MonoForce's folder"):
        read_frame(tmp_path)


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
