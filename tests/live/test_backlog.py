"""Messages that wait: bounded by number and by size; those for a step stay in their order."""

from offpiste.live.backlog import Backlog, Batch
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
