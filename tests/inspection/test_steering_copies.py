"""Fields that repeat the steering late pass for its command, unless they are measured of the motion."""

from simulated import MemoryLog, drive_log, rig

from offpiste.inspection.recorded_log import RememberedLog, read_topics
from offpiste.inspection.steering_copies import check_copies
from offpiste.logs.drive import drive_from_log


def test_a_gyroscope_is_no_late_copy_of_the_steering() -> None:
    log = drive_log(seed=0)
    time, columns = log.data["steering"]

    def named(topic: str) -> list[str]:
        late = {topic: (time + 0.5, {"z": columns["command"]})}
        both = MemoryLog({**log.data, **late})
        recorded, _ = read_topics(RememberedLog(both, rig()), rig())
        return [finding.where for finding in check_copies(drive_from_log(both, rig()), recorded)]

    assert named("/status") == ["/status z"]
    assert named("/imu/imu") == []
