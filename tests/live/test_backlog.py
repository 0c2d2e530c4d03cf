"""Messages that wait: bounded by number and by size; those for a step stay in their order."""

from offpiste.live.backlog import LATCHED, Backlog, Batch
from offpiste.transport.interface import Received
from offpiste.transport.tally import Tally


def message(topic, size):
    return Received(topic, "", bytes(size), 0.0)


def test_the_oldest_give_way_by_number_and_by_size():
    dropped = Tally()
    backlog = Backlog(3, dropped, size=100, why="too slow")
    for size in (60, 30, 30):
        backlog.put(message(f"/{size}", size))
    assert dropped == {"/60: too slow": 1}
    for _ in range(3):
        backlog.put(message("/small", 1))
    assert dropped == {"/60: too slow": 1, "/30: too slow": 2}
    assert [backlog.get(0.0).topic for _ in range(3)] == ["/small"] * 3
    backlog.put(message("/image", 100))
    assert len(backlog.get(0.0).data) == 100, "what was taken holds nothing"
    assert backlog.get(0.0) is None


def test_of_large_topics_the_newest_are_kept_and_all_in_their_order():
    batch = Batch({"/image", "/points"}, size=100)
    for topic, size in (("/image", 60), ("/tf", 500), ("/points", 90), ("/image", 50), ("/odom", 1), ("/points", 900)):
        batch.add(message(topic, size))
    assert [(one.topic, len(one.data)) for one in batch.taken()] == [
        ("/tf", 500), ("/image", 50), ("/odom", 1), ("/points", 900),
    ]  # fmt: skip
    assert not batch
    batch.add(message("/image", 100))
    assert len(batch.taken()) == 1, "what was taken holds nothing"


def test_a_spike_of_other_topics_drops_no_latched_message():
    dropped = Tally()
    backlog = Backlog(256, dropped, latched=("/course", "/tf_static"))
    for topic in ("/course", "/tf_static", "/tf_static"):
        backlog.put(message(topic, 1))
    for _ in range(10_000):
        backlog.put(message("/odometry", 1))
    assert dropped == {"/odometry: comes faster than it is decoded": 10_000 - 256}
    assert [backlog.get(0.0).topic for _ in range(4)] == ["/course", "/tf_static", "/tf_static", "/odometry"]


def test_a_latched_topic_keeps_a_bounded_number():
    backlog = Backlog(4, Tally(), latched=("/course",))
    for size in range(100):
        backlog.put(message("/course", size))
    kept = [len(backlog.get(0.0).data) for _ in range(LATCHED)]
    assert kept == list(range(100 - LATCHED, 100))
    assert backlog.get(0.0) is None
