"""Viewers of a drive: what `offpiste live --view NAME` shows it in, a file each."""
