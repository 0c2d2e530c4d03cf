"""Faults while `offpiste live --drive` drives `offpiste simulate --live`: is it stopped, and does it resume."""
