"""Scores `offpiste inspect` on simulated logs with known truth: `python -m experiments.illnesses --out illnesses`."""

from experiments.command import run
from experiments.illnesses.trial import Illnesses

if __name__ == "__main__":
    run(Illnesses)
