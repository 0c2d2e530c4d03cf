"""`offpiste inspect --rig` on cameras and LiDARs: they should see the world where rig and poses say that it is."""

from offpiste.perception.checks.inspect import check_sensors

__all__ = ["check_sensors"]
