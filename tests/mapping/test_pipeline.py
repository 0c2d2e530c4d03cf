"""The loop from clouds to layers, with the encoder before the map or after it."""

from dataclasses import replace

import numpy as np
import pytest

from offpiste.mapping.pipeline import FeatureCloud, MapPipeline, MapSettings
from offpiste.mapping.voxel_map import VoxelSettings

RNG = np.random.default_rng(0)
WEIGHT = RNG.normal(size=(40, 4)).astype(np.float32)


def encode(features):
    """Not linear, as an encoder is."""
    return np.tanh(features @ WEIGHT).astype(np.float32)


def drive(pipeline, seed=0, scans=6):
    """A vehicle that drives about over bumpy ground; cameras miss a third of the points."""
    rng = np.random.default_rng(seed)
    for step in range(scans):
        vehicle = np.array([0.7 * step, -0.3 * step, 0.0])
        points = vehicle + rng.uniform(-4, 4, (2000, 3)) * [1, 1, 0.1]
        features = rng.normal(size=(2000, 40)).astype(np.float32)
        pipeline.add(FeatureCloud(points, vehicle + np.array([0, 0, 1.8]), features, rng.random(2000) < 0.66), vehicle)
        pipeline.add(FeatureCloud(points[:100] + 0.05, vehicle), vehicle)  # a scan without an image
    return pipeline.layers()


def encoded(layers):
    """The layers with codes in the place of features."""
    codes = np.full((*layers.valid.shape, WEIGHT.shape[1]), np.nan, np.float32)
    codes[layers.valid] = encode(layers.features[layers.valid])
    return replace(layers, features=codes)


def settings(rule):
    return MapSettings(VoxelSettings(reach=4.0, capacity=50_000, rule=rule))


@pytest.mark.parametrize("rule", ["closest", "latest"])
def test_encoding_before_or_after_the_map_is_the_same(rule):
    after = encoded(drive(MapPipeline(40, settings(rule))))
    before = drive(MapPipeline(4, settings(rule), encode))
    assert before.valid.mean() > 0.5
    for name in ("valid", "known", "distance", "elevation", "normal"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
    np.testing.assert_allclose(before.features, after.features, atol=1e-5)


def test_averaging_and_encoding_do_not_commute():
    after = encoded(drive(MapPipeline(40, settings("average"))))
    before = drive(MapPipeline(4, settings("average"), encode))
    np.testing.assert_array_equal(before.valid, after.valid)
    assert np.nanmax(np.abs(before.features - after.features)) > 0.1


def test_the_map_follows_the_vehicle():
    pipeline = MapPipeline(0, settings("closest"))
    nothing = FeatureCloud(np.zeros((0, 3)), np.zeros(3))
    for place in ([0.0, 0.0, 0.0], [654_321.0, 4_567_890.0, 321.0]):
        pipeline.add(nothing, np.array(place))
        layers = pipeline.layers()
        np.testing.assert_allclose(layers.origin + 3.9, place[:2], atol=0.1001)
        assert not layers.known.any()
    pipeline = MapPipeline(1, settings("closest"))
    pipeline.add(FeatureCloud(np.array([[3.1, 0.1, 0.0]]), np.array([0.1, 0.1, 4.0]), np.ones((1, 1))), np.zeros(3))
    assert np.nanmin(pipeline.layers().distance) == pytest.approx(5.0)  # from the sensor
