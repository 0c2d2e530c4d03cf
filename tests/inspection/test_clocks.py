"""Clocks that the speed of the wheels shows to be late, and what only looks like it."""

import numpy as np
from simulated import drive_log, rig

from offpiste.inspection.clocks import check_clocks
from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.recorded_log import RememberedLog, read_topics
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited

CLEAN = drive_log(seconds=60)


def test_a_speed_that_follows_the_throttle_is_no_clock() -> None:
    """An electric car goes as fast as its throttle says, 0.6 s later."""
    time, odom = CLEAN.data["odom"]
    pedals, _ = CLEAN.data["pedals"]
    ahead = np.interp(pedals + 0.6, time, odom["vx"]) / odom["vx"].max()
    log = CLEAN.change("pedals", "throttle", lambda _: ahead)
    recorded, _ = read_topics(RememberedLog(log), rig().clock)
    path = driven_path(drive_from_log(log, rig()))
    assert check_clocks(recorded, path, rig(), besides={"odom"}) == []
    # The same of a field that no control reads is a speed by another clock.
    assert check_clocks(recorded, path, edited(rig(), [Edit("channels.throttle.fields", ["brake"])]), besides={"odom"})
