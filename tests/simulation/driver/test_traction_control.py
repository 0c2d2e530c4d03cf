from offpiste.conventions import DT
from offpiste.simulation.driver.traction_control import TractionControl


def test_without_spin_the_throttle_follows_the_request():
    traction = TractionControl()
    throttles = [traction.throttle(0.7, 0.0, 1.0) for _ in range(100)]
    assert throttles[0] < 0.2 < 0.7 - 1e-3 < throttles[-1] <= 0.7


def test_it_holds_the_spin_of_sliding_wheels():
    # Wheels on ice: spin grows by 20 m/s^2 per throttle beyond 0.3, which the ground takes up.
    traction, spin, spins = TractionControl(), 0.0, []
    for _ in range(500):
        spin = max(spin + DT * 20 * (traction.throttle(1.0, spin, 0.5) - 0.3), 0.0)
        spins.append(spin)
    assert max(spins) < 5
    assert max(spins[250:]) < 1.0
    assert min(spins[250:]) > 0.1


def test_grip_returns_the_throttle():
    traction = TractionControl()
    for _ in range(200):
        spinning = traction.throttle(1.0, 5.0, 0.5)
    for _ in range(200):
        gripping = traction.throttle(1.0, 0.0, 2.0)
    assert spinning < 0.05
    assert gripping > 0.9
