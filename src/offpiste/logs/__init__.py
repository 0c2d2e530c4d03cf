"""Recorded drives of any format, read as named channels in SI units."""

from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive, read_drive
from offpiste.logs.log import Log, Samples, Topic, open_log

__all__ = ["Channel", "Drive", "Log", "Samples", "Topic", "open_log", "read_drive"]
