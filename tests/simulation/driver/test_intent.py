import numpy as np

from offpiste.simulation.driver.intent import RandomIntent


def intents(seed: int, count: int):
    stream = RandomIntent(np.random.default_rng(seed), pause=3.5)
    return [stream.advance() for _ in range(count)]


def test_processes_are_standard_normal_and_correlated_in_time():
    speed, cornering, steering = np.array([i[:3] for seed in range(40) for i in intents(seed, 3000)[::50]]).T
    for process in (speed, cornering, steering):
        assert abs(process.mean()) < 0.25
        assert abs(process.std() - 1) < 0.15
    steps = np.array([i[:3] for i in intents(0, 3000)])
    # One second apart: exp(-1/7) for speed, exp(-1/0.7) for steering.
    lagged = [np.corrcoef(process[50:], process[:-50])[0, 1] for process in steps.T]
    assert lagged[0] > 0.7
    assert lagged[2] < 0.5


def test_every_manoeuvre_comes_up_and_ends():
    manoeuvres = [i.manoeuvre for i in intents(1, 30_000)]
    assert set(manoeuvres) == {"", "throttle", "brake", "coast", "swerve", "brake and swerve", "stop"}
    assert 0.5 < np.mean([manoeuvre == "" for manoeuvre in manoeuvres]) < 0.85
    assert all(i.time_left > -0.03 for i in intents(1, 3000) if i.manoeuvre)


def test_the_same_seed_gives_the_same_intents():
    assert intents(5, 500) == intents(5, 500)
    assert intents(5, 500) != intents(6, 500)
