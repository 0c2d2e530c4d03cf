"""Counts by reason: few reasons, and several threads."""

import threading

from offpiste.transport.tally import MOST, OTHERS, Tally
from transport.routers import until


class Slow(int):
    """A count during whose comparison another thread counts something new."""

    tally: Tally

    def __gt__(self, other):
        counting = threading.Thread(target=self.tally.add, args=("new",))
        counting.start()
        counting.join(0.2)
        return int(self) > other


def test_a_snapshot_is_whole_though_another_thread_counts_meanwhile():
    tally = Tally()
    Slow.tally = tally
    tally["slow"] = Slow(2)
    tally.add("none", 0)
    assert tally.snapshot() == {"slow": 2}
    tally["slow"] = 2
    assert until(lambda: tally.snapshot() == {"slow": 2, "new": 1})


def test_reasons_are_counted_by_name_up_to_a_number_of_them():
    tally = Tally()
    for k in range(2 * MOST):
        tally.add(str(k))
    assert tally.snapshot()[OTHERS] == MOST
    assert len(tally) == MOST + 1
