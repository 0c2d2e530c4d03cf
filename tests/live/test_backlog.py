"""Messages that wait: bounded by number and by size."""

from offpiste.live.backlog import Backlog
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
