"""Messages that wait: bounded by number and by size; those for a step stay in their order."""

from offpiste.live.backlog import Backlog, Batch
from offpiste.transport.interface import Received
from offpiste.transport.tally import Tally


def message(topic, size):
    return Received(topic, "", bytes(size), 0.0)


def test_the_topic_that_takes_the_most_room_loses_its_oldest_message():
    dropped = Tally()
    backlog = Backlog(3, dropped, size=100, why="too slow")
    for topic, size in (("/scan", 40), ("/scan", 30), ("/image", 45)):
        backlog.put(message(topic, size))
    assert dropped == {"/scan: too slow": 1}, "by size"
    for size in range(3):
        backlog.put(message("/odom", size))
    assert dropped == {"/scan: too slow": 1, "/odom: too slow": 2}, "by number"
    assert [(one.topic, len(one.data)) for one in (backlog.get(0.0) for _ in range(3))] == [
        ("/scan", 30), ("/image", 45), ("/odom", 2),
    ]  # fmt: skip
    backlog.put(message("/image", 100))
    assert len(backlog.get(0.0).data) == 100, "what was taken takes no room"
    backlog.put(message("/odom", 1))
    backlog.put(message("/image", 101))
    assert backlog.get(0.0).topic == "/odom", "a message that does not fit drops no only message of another topic"
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


def test_a_spike_of_other_topics_drops_no_only_message():
    dropped = Tally()
    backlog = Backlog(256, dropped)
    for topic in ("/odometry", "/course", "/tf_static", "/tf_static"):
        backlog.put(message(topic, 1000))
    for _ in range(5_000):
        backlog.put(message("/odometry", 1))
        backlog.put(message("/engine", 1))
    assert dropped.keys() == {f"{topic}: comes faster than it is decoded" for topic in ("/odometry", "/engine")}
    assert dropped.total() == 10_004 - 256
    assert [backlog.get(0.0).topic for _ in range(3)] == ["/course", "/tf_static", "/tf_static"]
