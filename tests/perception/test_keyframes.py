"""Selection of images by travel and diversity."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from offpiste.core.errors import PerceptionError
from offpiste.perception.keyframes import image_statistics, keyframes_by_travel, most_diverse


def test_zero_metres_take_every_frame_with_a_pose():
    position = np.array([[np.nan, 0.0], [0.0, 0.0], [0.0, 0.0], [1.0, np.nan], [2.0, 0.0]])
    assert keyframes_by_travel(position, 0.0).tolist() == [1, 2, 4]
    assert keyframes_by_travel(position[:1], 0.0).tolist() == []


@given(seed=st.integers(0, 99), metres=st.floats(0.1, 5.0))
def test_no_frame_left_out_is_far_from_the_one_before_it(seed: int, metres: float):
    position = np.random.default_rng(seed).normal(size=(60, 2)).cumsum(axis=0)
    chosen = keyframes_by_travel(position, metres)
    steps = np.linalg.norm(np.diff(position[chosen], axis=0), axis=1)
    assert (steps >= metres).all()
    for index in set(range(60)) - set(chosen.tolist()):
        before = chosen[chosen < index][-1]
        assert np.linalg.norm(position[index] - position[before]) < metres


def test_the_most_diverse_of_clusters_are_one_of_each():
    generator = np.random.default_rng(0)
    middles = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0], [10.0, 10.0]])
    cluster = np.repeat(np.arange(4), [500, 5, 30, 2])
    statistics = middles[cluster] + generator.normal(scale=0.1, size=(len(cluster), 2))
    for seed in range(5):
        assert sorted(cluster[most_diverse(statistics, 4, seed=seed)]) == [0, 1, 2, 3]


def test_fewer_images_than_asked_for_and_images_all_alike():
    assert most_diverse(np.zeros((5, 3)), 175, seed=0).tolist() == [0, 1, 2, 3, 4]
    assert len(np.unique(most_diverse(np.zeros((5, 3)), 3, seed=0))) == 3
    for statistics in (np.empty((0, 3)), np.full((2, 3), np.nan)):
        with pytest.raises(PerceptionError, match="no images to choose from"):
            most_diverse(statistics, 3, seed=0)


def test_statistics_tell_light_colour_and_texture_apart():
    generator = np.random.default_rng(0)
    grey = np.full((90, 120, 3), 120, dtype=np.uint8)
    sky = grey.copy()
    sky[:30] = 255  # above the lower two thirds
    rough = generator.integers(60, 180, size=grey.shape, dtype=np.uint8)
    dark, green = grey // 2, grey - np.array([60, 0, 60], dtype=np.uint8)
    assert np.array_equal(image_statistics(sky), image_statistics(grey))
    statistics = np.stack([image_statistics(image) for image in (grey, rough, dark, green)])
    assert statistics.shape == (4, 14)
    distance = np.linalg.norm(statistics[:, None] - statistics[None], axis=2)
    assert distance[~np.eye(4, dtype=bool)].min() > 1.0
