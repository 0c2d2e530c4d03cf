"""A camera model of each kind of distortion."""

import numpy as np

from offpiste.rig.camera import CameraModel

MATRIX = np.array([[310.0, 0.0, 322.5], [0.0, 312.0, 233.1], [0.0, 0.0, 1.0]])

MODELS = {
    "plumb_bob": CameraModel(640, 480, MATRIX, (-0.227, 0.072, -0.0007, 0.0009, 0.0), "plumb_bob"),
    "pincushion": CameraModel(640, 480, MATRIX, (0.1, 0.01, 0.0, 0.0, 0.0), "plumb_bob"),
    "rational_polynomial": CameraModel(
        640, 480, MATRIX, (0.9, 0.2, 0.0004, -0.0003, 0.01, 1.2, 0.4, 0.03), "rational_polynomial"
    ),
    "equidistant": CameraModel(640, 480, MATRIX, (0.03, -0.01, 0.002, -0.0004), "equidistant"),
}
