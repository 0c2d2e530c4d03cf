"""The loop from clouds to layers."""

import numpy as np
import pytest

from offpiste.mapping.pipeline import FeatureCloud, MapPipeline, MapSettings
from offpiste.mapping.voxel_map import VoxelSettings


def settings(rule):
    return MapSettings(VoxelSettings(reach=4.0, capacity=50_000, rule=rule))


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
