import numpy as np

from offpiste.simulation.driver.intent import Mood


def feelings(seed: int, count: int):
    mood = Mood(np.random.default_rng(seed), pause=3.5)
    return [mood.advance() for _ in range(count)]


def test_moods_are_standard_and_remember():
    speed, cornering, play = np.array([f[:3] for seed in range(40) for f in feelings(seed, 3000)[::50]]).T
    for process in (speed, cornering, play):
        assert abs(process.mean()) < 0.25
        assert abs(process.std() - 1) < 0.15
    steps = np.array([f[:3] for f in feelings(0, 3000)])
    # One second apart: exp(-1/7) for speed, exp(-1/0.7) for play.
    lagged = [np.corrcoef(process[50:], process[:-50])[0, 1] for process in steps.T]
    assert lagged[0] > 0.7
    assert lagged[2] < 0.5


def test_every_idea_comes_up_and_ends():
    ideas = [f.idea for f in feelings(1, 30_000)]
    assert set(ideas) == {"", "throttle", "brake", "coast", "swerve", "brake and swerve", "stop"}
    assert 0.5 < np.mean([idea == "" for idea in ideas]) < 0.85
    assert all(f.left > -0.03 for f in feelings(1, 3000) if f.idea)


def test_the_same_seed_feels_the_same():
    assert feelings(5, 500) == feelings(5, 500)
    assert feelings(5, 500) != feelings(6, 500)
