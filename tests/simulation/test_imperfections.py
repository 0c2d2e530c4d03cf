from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from offpiste.simulation.recorder import NOISE, Drift, Imperfections, with_noise
from offpiste.simulation.sample import VehicleSample
from synthetic_drive import samples

STILL = replace(samples()[0], orientation=Rotation.from_euler("ZYX", (1.0, 0.4, -0.3)).as_quat())


def drifted(amount: float, count: int, seed: int = 0) -> list[VehicleSample]:
    drift = Drift(amount, np.random.default_rng(seed))
    return [drift.apply(sample) for sample in samples()[:count]]


def test_drift_starts_at_the_truth_and_leaves_height_and_body_velocity() -> None:
    found, true = drifted(2.0, 3000), samples()[:3000]
    np.testing.assert_allclose(found[0].position, true[0].position)
    body = lambda s: Rotation.from_quat(s.orientation).inv().apply(s.velocity)  # noqa: E731
    np.testing.assert_allclose([body(s) for s in found], [body(s) for s in true], atol=1e-9)
    assert all(f.position[2] == t.position[2] for f, t in zip(found, true, strict=True))


def test_drift_of_a_parked_vehicle_is_a_random_walk_of_the_stated_size() -> None:
    def end(seed: int) -> VehicleSample:
        drift = Drift(2.0, np.random.default_rng(seed))
        return [drift.apply(replace(STILL, time=float(t))) for t in range(0, 61, 10)][-1]

    ends = [end(seed) for seed in range(200)]
    away = np.array([sample.position - STILL.position for sample in ends])
    turn = [(Rotation.from_quat(s.orientation) * Rotation.from_quat(STILL.orientation).inv()).as_rotvec() for s in ends]
    np.testing.assert_allclose(away[:, :2].std(axis=0), 2.0, rtol=0.15)
    np.testing.assert_allclose(np.degrees(turn).std(axis=0), (0, 0, 2.0), rtol=0.15, atol=1e-6)


def test_noise_has_the_stated_size_in_every_channel() -> None:
    noise, rng = NOISE, np.random.default_rng(0)
    found = [with_noise(replace(STILL, brake_pressure=0.5), Imperfections(0.012), rng) for _ in range(4000)]
    spread = lambda name: np.array([getattr(s, name) for s in found]).std(axis=0)  # noqa: E731
    for name, sigma in (
        ("position", 0.013),  # 5 mm and 12 mm
        ("velocity", noise.velocity),
        ("angular_velocity", noise.rate),
        ("brake_pressure", noise.pressure),
        ("steer_angle", np.radians(noise.steer_angle)),
        ("steer_rate", np.radians(noise.steer_rate)),
        ("engine_speed", noise.engine_speed),
        ("wheel_speed", noise.wheel_speed),
    ):
        np.testing.assert_allclose(spread(name), sigma, rtol=0.06, err_msg=name)
    tilt = [
        (Rotation.from_quat(STILL.orientation).inv() * Rotation.from_quat(s.orientation)).as_rotvec() for s in found
    ]
    np.testing.assert_allclose(np.degrees(tilt).std(axis=0), noise.attitude, rtol=0.06)
    np.testing.assert_array_equal(found[0].command, STILL.command)
