"""Run time on a vehicle: sensor messages in, commands out."""
