"""Recorded drives in any format -> named channels in SI units."""

from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive, read_drive
from offpiste.logs.log import Log, Samples, Topic
from offpiste.logs.opening import open_log

__all__ = ["Channel", "Drive", "Log", "Samples", "Topic", "open_log", "read_drive"]
