"""Times of stages: all of them for reports, the last ones where nobody asks."""

from offpiste.runtime.perception import Stopwatch


def test_a_stopwatch_keeps_all_times_or_the_last_ones():
    every, last = Stopwatch(), Stopwatch(last=2)
    for watch in (every, last):
        for _ in range(10):
            with watch.of("plan"):
                pass
    assert every.summary()["plan"]["count"] == 10
    assert last.summary()["plan"]["count"] == 2
