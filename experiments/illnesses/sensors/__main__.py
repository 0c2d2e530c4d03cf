"""Scores the checks of cameras and LiDARs: `python -m experiments.illnesses.sensors --out sensors`."""

from experiments.command import run
from experiments.illnesses.sensors.trial import SensorIllnesses

if __name__ == "__main__":
    run(SensorIllnesses)
